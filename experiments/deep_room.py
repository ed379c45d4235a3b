"""What frames of 12 bits gain in a faint room: the same room with the same noise, in 8 bits and in 12.

    python -m experiments.deep_room

The reference rig's room, rendered in a quarter of its size. The sensor has 10,000 electrons at the top of its range and
4 electrons of read noise; each row of the table has less light, of room and laser. True centres are those of the
rendering. Prints a table for docs/captures.md; a minute on two cores.
"""

import numpy as np

from jaxscan.files.disk import load_toml
from jaxscan.simulation import SimulationConfig, develop, expect_record, make_rig, make_scene
from jaxscan.stripes import (
    ExtractionSetup,
    FrameFormat,
    LaserLine,
    StripeSettings,
    level_exposures,
    prepare_engines,
    split_levels,
)


WORLD = "configs/reference.toml"
SHRUNK, STEPS = 4, 12
LIGHTS = (1.0, 0.25, 0.1, 0.05, 0.025)
ELECTRONS, READ = 10_000.0, 4.0


def world(light: float, bits: int) -> SimulationConfig:
    """The reference room under so much of its light, seen by a small camera of so many bits."""
    config = load_toml(WORLD, SimulationConfig)
    camera = {key: getattr(config.camera, key) / SHRUNK for key in ("fx", "fy", "cx", "cy")}
    camera |= {key: getattr(config.camera, key) // SHRUNK for key in ("width", "height")}
    sensor = {"bits": bits, "electrons_per_dn": ELECTRONS / 255, "read_dn": READ * 255 / ELECTRONS}
    laser = config.laser[0].model_copy(update={"peak_dn": light * config.laser[0].peak_dn})
    return config.model_copy(
        update={
            "camera": config.camera.model_copy(update=camera),
            "sensor": config.sensor.model_copy(update=sensor),
            "light": config.light.model_copy(update={"white_dn": light * config.light.white_dn}),
            "laser": (laser,),
        }
    )


def found(light: float, bits: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Errors of the centres found on all lines, those over their sigmas, where they are found, and true peaks."""
    config = world(light, bits)
    rig, scene, rng = make_rig(config), make_scene(config), np.random.default_rng(0)
    angles = np.linspace(0, 2 * np.pi, STEPS, endpoint=False)
    records = [develop(expect_record(rig, scene, float(angle)), config, rng) for angle in angles]
    u, there, peak = (np.stack([getattr(one.truth, name) for one in records]) for name in ("u", "valid", "amplitude"))
    on, off = (np.stack([getattr(one, name) for one in records]) for name in ("on", "off"))
    exposures, level = (1.0,), None
    if bits > 8:
        exposures, level = level_exposures(bits), 0
        on, off = (np.stack([[one for one, _ in split_levels(f, bits)] for f in frames]) for frames in (on, off))
    size = config.camera.width, config.camera.height
    setup = ExtractionSetup(size, FrameFormat(), LaserLine(), StripeSettings(), exposures, level)
    (engine,) = prepare_engines(on, off, [setup])
    stripes = engine.learn(on, off).extract(on, off).stripes
    error = (np.asarray(stripes.u) - u)[there]
    valid = np.asarray(stripes.valid)[there]
    return error, error / np.where(valid, np.asarray(stripes.sigma)[there], 1.0), valid, peak[there]


def spread(values: np.ndarray) -> float:
    """Their standard deviation, whatever corners and edges of furniture do."""
    return float(np.median(np.abs(values)) / 0.6745)


def main() -> None:
    """Print the table; errors are of the lines that both find."""
    print("| light | median peak [DN] | 8 bits: found | error | over sigma | 12 bits: found | error | over sigma |")
    print("|---|---|---|---|---|---|---|---|")
    for light in LIGHTS:
        both = [found(light, bits) for bits in (8, 12)]
        common = both[0][2] & both[1][2]
        cells = [
            f"{100 * valid.mean():.1f} % | {spread(error[common]):.4f} px | {spread(ratio[common]):.2f}"
            for error, ratio, valid, _ in both
        ]
        print(f"| {light:g} | {np.median(both[0][3]):.1f} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
