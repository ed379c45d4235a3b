"""What frames of 12 bits gain over the same frames with the same noise in 8 bits.

    python -m experiments.deep_frames [lines|room]

lines: stripes of one brightness after the other in a dark room, some seconds. room: the reference rig's room in images
of a quarter of their size, in ever less light of room and laser; errors are of the lines that both find; a minute. A
sensor of 10,000 electrons with 4 electrons of read noise; the noise is learned from the frames. Each prints its table
for docs/captures.md.
"""

import numpy as np
from scipy.special import erf

from experiments.exact_rig import reference
from experiments.report import command_line, rms, table
from jaxscan.simulation import SimulationConfig, develop, expect_record, make_rig, make_scene
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


ELECTRONS, READ, BITS = 10_000.0, 4.0, 12
ROWS, COLUMNS, FRAMES, WIDTH_PX = 256, 512, 12, 1.6
PEAKS = (40, 80, 160, 320, 1000, 3500, 12_000)
STEPS, LIGHTS = 12, (1.0, 0.25, 0.1, 0.05, 0.025)


def extracted(on: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres, their sigmas and which exist, of frames of 8 bits, or of more, which are taken as levels."""
    exposures, level = (1.0,), None
    size = on.shape[:0:-1]
    if on.dtype == np.uint16:
        exposures, level = level_exposures(BITS), 0
        on, off = (np.stack([[one for one, _ in split_levels(f, BITS)] for f in frames]) for frames in (on, off))
    setup = ExtractionSetup(size, FrameFormat(), LaserLine(), StripeSettings(), exposures, level)
    (engine,) = prepare_engines(on, off, [setup])
    found = engine.learn(on, off).extract(on, off).stripes
    return np.asarray(found.u), np.asarray(found.sigma), np.asarray(found.valid)


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


def lines() -> list[list[str]]:
    """A row for each peak."""
    rng, rows = np.random.default_rng(0), []
    for peak in PEAKS:
        u, *deep = photographed(peak, rng)
        rows.append([f"{peak}"])
        for on, off in ([to_8_bits(frames, BITS) for frames in deep], deep):
            centre, sigma, valid = extracted(on, off)
            error = (centre - u)[valid]
            ratio = np.std(error / sigma[valid])
            rows[-1] += [f"{100 * valid.mean():5.1f} %", f"{rms(error):.4f} px", f"{ratio:.2f}"]
    return rows


def faint(light: float, bits: int) -> SimulationConfig:
    """The reference room under so much of its light, seen by a small camera of so many bits."""
    config = reference()
    camera = {key: getattr(config.camera, key) / 4 for key in ("fx", "fy", "cx", "cy")}
    camera |= {key: getattr(config.camera, key) // 4 for key in ("width", "height")}
    sensor = {"bits": bits, "electrons_per_dn": ELECTRONS / 255, "read_dn": READ * 255 / ELECTRONS}
    laser = config.laser[0].model_copy(update={"peak_dn": light * config.laser[0].peak_dn})
    lamp = config.light.model_copy(update={"white_dn": light * config.light.white_dn})
    return config.model_copy(
        update={
            "camera": config.camera.model_copy(update=camera),
            "sensor": config.sensor.model_copy(update=sensor),
            "light": lamp,
            "laser": (laser,),
        }
    )


def room() -> list[list[str]]:
    """A row for each light; spreads are robust, whatever corners and edges of furniture do."""
    spread = lambda values: float(np.median(np.abs(values)) / 0.6745)
    rows = []
    for light in LIGHTS:
        both, peak = [], 0.0
        for bits in (8, BITS):
            config = faint(light, bits)
            rig, scene, rng = make_rig(config), make_scene(config), np.random.default_rng(0)
            angles = np.linspace(0, 2 * np.pi, STEPS, endpoint=False)
            records = [develop(expect_record(rig, scene, float(angle)), config, rng) for angle in angles]
            truth = [np.stack([getattr(one.truth, name) for one in records]) for name in ("u", "valid", "amplitude")]
            seen = extracted(*(np.stack([getattr(one, name) for one in records]) for name in ("on", "off")))
            u, sigma, valid = (part[truth[1]] for part in seen)
            error, peak = u - truth[0][truth[1]], float(np.median(truth[2][truth[1]]))
            both.append((error, error / np.where(valid, sigma, 1.0), valid))
        common = both[0][2] & both[1][2]
        rows.append([f"{light:g}", f"{peak:.1f}"])
        for error, ratio, valid in both:
            rows[-1] += [
                f"{100 * valid.mean():.1f} %",
                f"{spread(error[common]):.4f} px",
                f"{spread(ratio[common]):.2f}",
            ]
    return rows


def main() -> None:
    """Print a table."""
    parser = command_line(__doc__)
    parser.add_argument("part", choices=("lines", "room"), nargs="?", default="lines")
    first, rows = {
        "lines": (["peak of 4095"], lines),
        "room": (["light", "median peak [DN]"], room),
    }[parser.parse_args().part]
    head = [title for bits in (8, BITS) for title in (f"{bits} bits: found", "error", "over sigma")]
    print(table([*first, *head], rows()))


if __name__ == "__main__":
    main()
