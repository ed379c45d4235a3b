"""What frames of 12 bits gain: stripes of one brightness after the other, in 8 bits and as levels of 12.

    python -m experiments.deep_frames

A sensor of 10,000 electrons with 4 electrons of read noise, and a room at 2 % of its range. Nothing but the frames is
given: the noise is learned from them. Prints a table for docs/captures.md; some seconds on two cores.
"""

import numpy as np
from scipy.special import erf

from jaxscan.stripes import (
    ExtractionSetup,
    FrameFormat,
    LaserLine,
    StripeSettings,
    level_exposures,
    prepare_engines,
    split_levels,
    to_8_bits,
)


ROWS, COLUMNS, FRAMES, BITS = 256, 512, 12, 12
ELECTRONS, READ, WIDTH_PX = 10_000.0, 4.0, 1.6
PEAKS = (40, 80, 160, 320, 1000, 3500, 12_000)


def photographed(peak: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """True centres, and laser-on and laser-off frames of stripes so bright [DN of 12 bits]."""
    full = (1 << BITS) - 1
    u = 200 + 40 * np.sin(np.arange(ROWS) / 60) + rng.uniform(-0.5, 0.5, (FRAMES, 1))
    x = np.arange(COLUMNS)
    room = 0.02 * full * (1 + 0.3 * np.sin(x / 50)) * np.ones((FRAMES, ROWS, 1))
    edges = erf((np.append(x, COLUMNS) - 0.5 - u[..., None]) / WIDTH_PX / np.sqrt(2))
    lit = room + peak * WIDTH_PX * np.sqrt(np.pi / 2) * np.diff(edges, axis=-1)

    def camera(light: np.ndarray) -> np.ndarray:
        electrons = rng.poisson(light * ELECTRONS / full) + rng.normal(0, READ, light.shape)
        return np.clip(np.rint(electrons * full / ELECTRONS + 0.01 * full), 0, full).astype(np.uint16)

    return u, camera(lit), camera(room)


def judged(u: np.ndarray, on: np.ndarray, off: np.ndarray, exposures: tuple[float, ...], level: int | None) -> str:
    """Part of the lines that are found, error of their centres, and that over their sigmas."""
    setup = ExtractionSetup((COLUMNS, ROWS), FrameFormat(), LaserLine(), StripeSettings(), exposures, level)
    (engine,) = prepare_engines(on, off, [setup])
    found = engine.learn(on, off).extract(on, off).stripes
    valid = np.asarray(found.valid)
    error = (np.asarray(found.u) - u)[valid]
    ratio = np.std(error / np.asarray(found.sigma)[valid])
    return f"{100 * valid.mean():5.1f} % | {np.sqrt(np.mean(error**2)):.4f} px | {ratio:.2f}"


def main() -> None:
    """Print the table."""
    rng = np.random.default_rng(0)
    print("| peak of 4095 | 8 bits: found | error | over sigma | 12 bits: found | error | over sigma |")
    print("|---|---|---|---|---|---|---|")
    for peak in PEAKS:
        u, on, off = photographed(peak, rng)
        plain = judged(u, to_8_bits(on, BITS), to_8_bits(off, BITS), (1.0,), None)
        deep = [np.stack([np.stack([one for one, _ in split_levels(f, BITS)]) for f in frames]) for frames in (on, off)]
        print(f"| {peak} | {plain} | {judged(u, *deep, level_exposures(BITS), 0)} |")


if __name__ == "__main__":
    main()
