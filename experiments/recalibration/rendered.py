"""Sweeps that were rendered: of `experiments.unkind.simulated` and of `experiments.unkind.path_traced`.

Stripes are extracted once and kept; stored calibrations are made from ideal boards, so that several serve one sweep.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

import jaxscan
from experiments.recalibration import world
from experiments.recalibration.calibrations import calibration_of
from experiments.recalibration.trial import Task
from experiments.recalibration.world import Noise, Sweeping
from experiments.unkind import truth
from experiments.unkind.scene import Rig, draw_rig
from experiments.unkind.simulated import CONFIG, draw_config
from jaxscan.calibration import Calibration
from jaxscan.geometry import Scanner
from jaxscan.recalibration import SweepStripes
from jaxscan.reconstruction.along import smooth_sweep
from jaxscan.simulation import SimulationConfig, true_scanner


SIMULATED = tuple(range(101, 111))
PATH_TRACED = (1, 2, 101, 102, 103)
"""Seeds of the worlds; stripes were developed on 1 and 2 too."""


def rendered_kinds(folder: Path, kept: Path) -> dict[str, Callable[[int], Task]]:
    """The kinds of trials on worlds in a folder; `kept` holds their stripes."""
    return {
        "rendered unkind": partial(simulated, folder=folder, kept=kept),
        "path-traced": partial(path_traced, folder=folder, kept=kept),
    }


def simulated(seed: int, folder: Path, kept: Path) -> Task:
    """A rendered sweep of `configs/unkind.toml`; ten worlds, each with a calibration of this seed."""
    number = SIMULATED[seed % len(SIMULATED)]
    config = draw_config(number)
    stored = calibration_of(config, "paper-like", seed)
    stripes = stripes_of(folder / f"simulated_{number}", stored, kept)
    how = Sweeping(steps=len(stripes.angle), noise=Noise(px=0.0))
    _, exact = world.true_sweep(config, 0, how)
    assert config.room is not None and np.allclose(exact.angle, stripes.angle)
    apart = ((0, 1, config.room.size_m[0]), (2, 3, config.room.size_m[1]))
    walls = np.where(exact.surface < 6, exact.surface, -1)
    return Task(stored, [stripes], true_scanner(config), walls, apart, known={"world": number})


def path_traced(seed: int, folder: Path, kept: Path) -> Task:
    """A sweep of a path-traced room; five worlds, each with a calibration of this seed."""
    number = PATH_TRACED[seed % len(PATH_TRACED)]
    path = folder / f"path_traced_{number}"
    true, sweep, _ = truth.load(path / "truth.npz")
    rig = draw_rig(np.random.default_rng([number, 14]))
    assert np.array_equal(rig.lens, true.lens)
    config = config_of(rig)
    stored = calibration_of(config, "paper-like", seed)
    walls = np.full(sweep.surface.shape[:2], -1)
    for wall, surface in enumerate(true.wall_surfaces):
        walls[(sweep.surface[..., 0] == surface) & ~sweep.edge[..., 0]] = wall
    apart = tuple((2 * k, 2 * k + 1, float(metres)) for k, metres in enumerate(true.dimensions))
    stripes = stripes_of(path, stored, kept)
    return Task(stored, [stripes], true_scanner(config), walls, apart, known={"world": number})


def config_of(rig: Rig) -> SimulationConfig:
    """The rig of a path-traced world as the simulator has rigs, with the board of `configs/unkind.toml`."""
    fx, fy, cx, cy, k1, k2, p1, p2 = (float(value) for value in rig.lens)
    plain = jaxscan.load_simulation(CONFIG).model_dump()
    plain["camera"] |= {"width": rig.width, "height": rig.height, "fx": fx, "fy": fy, "cx": cx, "cy": cy}
    plain["camera"] |= {"k1": k1, "k2": k2, "p1": p1, "p2": p2}
    sheet = {"normal": tuple(rig.normal), "distance_m": rig.distance, "origin_m": tuple(rig.source)}
    plain["laser"] = [{"name": "red", "colour": "red", **sheet}]
    axis = {"direction": tuple(rig.direction), "point_m": tuple(rig.point), "tr": None}
    plain["turntable"] = {"carries": "scanner", "gain": rig.gain, "harmonics": tuple(rig.harmonics), **axis}
    return SimulationConfig.model_validate(plain)


def stripes_of(folder: Path, stored: Calibration, kept: Path) -> SweepStripes:
    """The stripes of a rendered sweep, as `jaxscan recalibrate` takes them from its capture."""
    path = kept / f"{folder.name}.npz"
    if not path.exists():
        kept.mkdir(parents=True, exist_ok=True)
        scanner = stored.scanner
        assert isinstance(scanner, Scanner)
        capture = jaxscan.open_capture(folder / "sweep")
        found = jaxscan.extract(capture, scanner).stripes
        along = smooth_sweep(found)
        valid = np.asarray(found.valid) & (along.sigma > 0)
        np.savez_compressed(
            path,
            centre=along.u,
            sigma=along.sigma,
            shared_lines=along.shared_lines,
            valid=valid,
            record=np.asarray(found.record),
            laser=np.asarray(found.laser),
            angle=np.asarray(capture.angles),
        )
    with np.load(path) as file:
        return SweepStripes(name=folder.name, stripe_axis="rows", **file)
