"""What frames of 12 bits gain in a faint room: the same room with the same noise, in 8 bits and in 12.

    python experiments/deep_room.py

The reference rig's room, rendered in a quarter of its size. The sensor has 10,000 electrons at the top of its range and 4
electrons of read noise; each row of the table has less light, of room and laser. True centres are those of the rendering.
Prints a table for docs/captures.md; a minute on two cores.
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


def judged(light: float, bits: int) -> tuple[str, float]:
    """Part of the true lines that are found, error of their centres, and that over their sigmas; median true peak."""
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
    found = engine.learn(on, off).extract(on, off).stripes
    both = np.asarray(found.valid) & there
    error = (np.asarray(found.u) - u)[both]
    # Lines at corners and edges of furniture have two pieces of the stripe: those that are pixels off are no noise.
    near = np.abs(error) < 2.0
    rms = float(np.sqrt(np.mean(error[near] ** 2)))
    middle = float(np.median(np.abs((error / np.asarray(found.sigma)[both])[near])) / 0.6745)
    share = 100 * np.count_nonzero(both) / np.count_nonzero(there)
    return f"{share:5.1f} % | {rms:.4f} px | {middle:.2f}", float(np.median(peak[there]))


def main() -> None:
    """Print the table."""
    print("| light | median peak, DN of 8 bits | 8 bits: found | error | over sigma | 12 bits: found | error | over sigma |")
    print("|---|---|---|---|---|---|---|---|")
    for light in LIGHTS:
        (plain, peak), (deep, _) = judged(light, 8), judged(light, 12)
        print(f"| {light:g} | {peak:.1f} | {plain} | {deep} |", flush=True)


if __name__ == "__main__":
    main()
