"""Stripes of sweeps through known rooms, without rendering, and calibrations of known quality.

Nothing here shares code with `geometry`: pixels are solved for with the lens, sheet and table of the simulator. Each
row of an image meets the laser's sheet in a line, and that leaves the room at a surface; the pixel where it does is
found to 1e-9 px.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d  # type: ignore[import-untyped]

from experiments.recalibration.crossings import Crossings, room_from_rig
from experiments.recalibration.surfaces import RoomSurfaces, box_of, facets_of
from experiments.worlds.ideal_rig import IdealRig
from jaxscan.recalibration import SweepStripes
from jaxscan.simulation import SimulationConfig, make_rig, rodrigues
from jaxscan.simulation.scene.meshes import Mesh


@dataclass(frozen=True)
class Noise:
    """Errors of stripe centres."""

    px: float = 0.1
    """Standard deviation of a centre [px], and the stated one."""
    shared_lines: int = 7
    """Lines over which smoothing has averaged the noise of rows."""
    neighbours: float = 0.0
    """Correlation between neighbouring profiles; nobody states it [1]."""
    pull_px: float = 0.0
    """Shift in a corner of the room, as light that comes back from the other wall has it [px]."""
    pull_m: float = 0.15
    """Distance from the corner at which it has fallen to 1 / e [m]."""
    stray: float = 0.0
    """Share of centres that are anywhere within 20 px [1]."""


UNKIND = Noise(px=0.08, shared_lines=9, neighbours=0.2, pull_px=0.05, pull_m=0.08, stray=1e-3)
"""Somewhat worse than stripes that were extracted from rendered sweeps of `configs/unkind.toml`: errors of 0.06 to
0.09 px as stated, shared by 9 lines, correlated by 0.04 at most between profiles, pulled by 0.03 px within 6 cm of a
corner, and 0.1 % of strays."""


@dataclass(frozen=True)
class Sweeping:
    """How a sweep is taken."""

    steps: int = 360
    turn_deg: float = 360.0
    """By the journal; beyond 360 it overlaps."""
    line_stride: int = 1
    """Only every n-th image row has a centre."""
    furniture: bool | None = None
    """None: as the configuration has it."""
    extras: Callable[[Mesh], None] | None = None
    """Adds surfaces to the room: see `surfaces.stepped` and `surfaces.curved`."""
    rough_m: float = 0.0
    """Roughness of all surfaces, a standard deviation [m]."""
    rough_length_m: float = 0.05
    """Distance at which its correlation has fallen to 0.6 [m]."""
    factor: float = 1.0
    """True turn over that of the journal: a wrong number of steps per turn [1]."""
    lost: tuple[int, float] | None = None
    """Record from which on the table stands elsewhere, and by how much [deg]."""
    wander_deg: float = 0.0
    """Standard deviation of independent errors of the steps [deg]."""
    station: int = 0
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    """By which the rig leans about its own x and y."""
    noise: Noise = Noise()


class TrueSweep(NamedTuple):
    """The truth of a sweep."""

    surface: np.ndarray
    """Of each centre [profiles, lines]: -1 none; 0 ... 5 walls x0, x1, y0, y1, floor, ceiling; more: other things."""
    point: np.ndarray
    """Room coordinates [profiles, lines, 3]; m."""
    centre: np.ndarray
    """Without noise [px]."""
    angle: np.ndarray
    """Where the table truly stood [records]; rad, before its own errors of gain and harmonics."""


def sweep_of(config: SimulationConfig, seed: int, how: Sweeping = Sweeping()) -> SweepStripes:
    """Stripes of a sweep of the configuration's room.

    Args:
        config: The true rig and its room; `room.rig_m` and `room.yaw_deg` say where it stands.
        seed: Of noise and roughness.
        how: How it is taken.
    """
    return true_sweep(config, seed, how)[0]


def true_sweep(config: SimulationConfig, seed: int, how: Sweeping = Sweeping()) -> tuple[SweepStripes, TrueSweep]:
    """As `sweep_of`, with the truth."""
    journal = np.deg2rad(how.turn_deg) * np.arange(how.steps) / how.steps
    random = np.random.default_rng([seed, 83])
    angle = journal * how.factor + np.deg2rad(how.wander_deg) * random.standard_normal(how.steps)
    if how.lost is not None:
        angle[how.lost[0] :] += np.deg2rad(how.lost[1])
    room = _room(config, how)
    height, lasers = config.camera.height, len(config.laser)
    shape = (how.steps * lasers, height)
    truth = TrueSweep(np.full(shape, -1), np.zeros((*shape, 3)), np.zeros(shape), angle)
    near_corner = np.zeros(shape)
    rig, place = IdealRig(config), room_from_rig(config, how.tilt_deg)
    # So many profiles at once that arrays stay in the cache of the processor.
    block = max(1, 200_000 * how.line_stride // height)
    for laser in range(lasers):
        for first in range(0, how.steps, block):
            part = np.arange(first, min(first + block, how.steps))
            found = Crossings(rig, room, place, laser, np.arange(0, height, how.line_stride)).solve(angle[part])
            at = np.ix_(part * lasers + laser, np.arange(0, height, how.line_stride))
            truth.centre[at], truth.point[at], truth.surface[at], near_corner[at] = found
    valid = truth.surface >= 0
    noise = how.noise
    error = noise.px * _noise(shape, noise, random) + noise.pull_px * near_corner
    stray = random.random(shape) < noise.stray
    error[stray] += random.uniform(-20, 20, int(stray.sum()))
    stripes = SweepStripes(
        name=f"simulated {seed}",
        centre=np.where(valid, truth.centre + error, 0.0),
        sigma=np.full(shape, noise.px),
        shared_lines=np.full(shape, float(noise.shared_lines)),
        valid=valid,
        record=np.repeat(np.arange(how.steps), lasers),
        laser=np.tile(np.arange(lasers), how.steps),
        angle=journal,
        stripe_axis=config.laser[0].stripe_axis,
        station=how.station,
    )
    return stripes, truth


def moved(config: SimulationConfig, rig_m: tuple[float, float, float], yaw_deg: float) -> SimulationConfig:
    """The same rig at another place in its room."""
    assert config.room is not None
    room = config.room.model_copy(update={"rig_m": rig_m, "yaw_deg": yaw_deg})
    return config.model_copy(update={"room": room})


def turn_laser(config: SimulationConfig, degrees: float, seed: int) -> SimulationConfig:
    """The first sheet turned about its laser by an angle, in a random direction."""
    random = np.random.default_rng([seed, 84])
    laser = config.laser[0]
    normal, _ = laser.plane()
    origin = make_rig(config).sheets[0].origin
    way = random.standard_normal(3)
    way -= (way @ normal) * normal
    turned = rodrigues(way / np.linalg.norm(way), np.deg2rad(degrees)) @ normal
    update = {"a": None, "b": None, "c_mm": None, "baseline_m": None, "crossing_m": None}
    update |= {"normal": tuple(turned), "distance_m": float(turned @ origin), "origin_m": tuple(origin)}
    return config.model_copy(update={"laser": (laser.model_copy(update=update), *config.laser[1:])})


def shift_axis(config: SimulationConfig, metres: float, seed: int) -> SimulationConfig:
    """The axis shifted across itself, in a random direction; the rig keeps its place in the room."""
    random = np.random.default_rng([seed, 85])
    rig = make_rig(config)
    way = random.standard_normal(3)
    way -= (way @ rig.direction) * rig.direction
    point = rig.point + metres * way / np.linalg.norm(way)
    update = {"tr": None, "direction": tuple(rig.direction), "point_m": tuple(point)}
    return config.model_copy(update={"turntable": config.turntable.model_copy(update=update)})


def _room(config: SimulationConfig, how: Sweeping) -> RoomSurfaces:
    assert config.room is not None
    furniture = config.room.furniture if how.furniture is None else how.furniture
    spec = config.room.model_copy(update={"furniture": furniture})
    simple = not furniture and how.extras is None and spec.mirror is None
    facets = None if simple else facets_of(spec, how.extras)
    return RoomSurfaces(box_of(spec), facets, how.rough_m, how.rough_length_m)


def _noise(shape: tuple[int, int], noise: Noise, random: np.random.Generator) -> np.ndarray:
    """Unit variance, correlated along lines as a mean over rows is, and from profile to profile."""
    field = random.standard_normal(shape, np.float32).astype(np.float64)
    if noise.shared_lines > 1:
        field = uniform_filter1d(field, noise.shared_lines, axis=1, mode="wrap") * np.sqrt(noise.shared_lines)
    rho = noise.neighbours
    for profile in range(1, len(field)) if rho else ():
        field[profile] = rho * field[profile - 1] + np.sqrt(1 - rho * rho) * field[profile]
    return field
