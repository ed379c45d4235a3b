"""Exact stripes of a room of boxes, seen from anywhere in it, by ray casting; NumPy and the simulator's rig."""

from functools import cache
from importlib.resources import files
from typing import NamedTuple

import numpy as np

from jaxscan.recalibration import SweepStripes
from jaxscan.simulation import Motion, SimulationConfig, distort, make_rig, rodrigues


FAN = 900
"""Rays of the laser's fan: more than one for each image row."""


class Room(NamedTuple):
    """A box, and boxes in it: low and high corners [m], z up."""

    size: tuple[float, float, float]
    boxes: tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...] = ()


EMPTY = Room((4.2, 5.4, 2.5))
FURNISHED = Room(
    (4.2, 5.4, 2.5),
    (
        ((0.0, 1.0, 0.0), (0.85, 3.0, 0.75)),  # sofa
        ((3.8, 3.2, 0.0), (4.2, 4.4, 2.0)),  # shelf
        ((1.6, 4.8, 0.0), (2.6, 5.4, 0.8)),  # chest
        ((3.0, 0.0, 0.0), (3.9, 0.6, 1.9)),  # cupboard
        ((0.0, 4.4, 1.2), (0.03, 5.2, 1.8)),  # picture
    ),
)
L_SHAPED = Room((4.2, 5.4, 2.5), (((2.6, 3.4, 0.0), (4.2, 5.4, 2.5)), ((0.0, 0.6, 0.0), (0.5, 1.8, 0.9))))


@cache
def demo() -> SimulationConfig:
    """The rig of the demo."""
    import tomllib

    return SimulationConfig.model_validate(tomllib.loads(files("jaxscan.data").joinpath("demo.toml").read_text()))


def pose(place: tuple[float, float, float], yaw_deg: float, tilt_deg: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """T_world_scanner of a rig at a place of the room [m], turned by yaw, then tilted about its x and y."""
    rotation = rodrigues(np.array([0.0, 0.0, 1.0]), np.deg2rad(yaw_deg))
    for axis, tilt in zip(np.eye(3), tilt_deg, strict=False):
        rotation = rotation @ rodrigues(axis, np.deg2rad(tilt))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, place
    return T


def cast(room: Room, origin: np.ndarray, way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First hits of rays [n, 3] from [3] or [n, 3] within the room: t [n], and which face [n]."""
    with np.errstate(divide="ignore", invalid="ignore"):
        size = np.array(room.size)
        far = np.where(way > 0, (size - origin) / way, np.where(way < 0, -origin / way, np.inf))
        axis = far.argmin(1)
        t, face = far.min(1), axis * 2 + (np.take_along_axis(way, axis[:, None], 1)[:, 0] > 0)
        for number, (low, high) in enumerate(room.boxes):
            ends = np.stack([(np.array(low) - origin) / way, (np.array(high) - origin) / way])
            near, leave = np.nanmax(ends.min(0), 1), np.nanmin(ends.max(0), 1)
            hit = (near < leave) & (near > 1e-6) & (near < t)
            side = ends.min(0).argmax(1) * 2 + (np.take_along_axis(way, ends.min(0).argmax(1)[:, None], 1)[:, 0] > 0)
            t, face = np.where(hit, near, t), np.where(hit, 6 * (number + 1) + side, face)
    return t, face


def sweep_of(
    room: Room, T_world_scanner: np.ndarray, *, steps: int = 120, noise_px: float = 0.1, seed: int = 0, station: int = 0
) -> SweepStripes:
    """The stripes that the demo's rig sees from a place: exact pixels and noise."""
    config = demo()
    rig, camera = make_rig(config), config.camera
    (sheet,) = rig.sheets
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * np.arange(steps) / steps
    tau = np.deg2rad(config.laser[0].fan_deg) * (np.arange(FAN) / (FAN - 1) - 0.5)
    fan = np.cos(tau)[:, None] * sheet.ahead + np.sin(tau)[:, None] * sheet.across
    centre, valid = np.zeros((steps, camera.height)), np.zeros((steps, camera.height), bool)
    world = Motion(T_world_scanner[:3, :3], T_world_scanner[:3, 3])
    for k, phi in enumerate(angle):
        T = world @ rig.pose(float(phi))
        start = T.apply(sheet.origin)
        t, face = cast(room, start, T.turn(fan))
        p = start + t[:, None] * T.turn(fan)
        local = T.inverse().apply(p)
        seen = local[:, 2] > 0.05
        x, y = (local[:, i] / np.where(seen, local[:, 2], 1.0) for i in range(2))
        # Far outside the image the lens has no meaning.
        seen &= (np.abs(x) < 1.2) & (np.abs(y) < 1.2)
        q = np.stack(distort(camera, np.clip(x, -1.2, 1.2), np.clip(y, -1.2, 1.2)), -1)
        seen &= cast(room, T.translation, p - T.translation)[0] > 1 - 1e-6
        first, then = q[:-1], q[1:]
        row = np.ceil(np.minimum(first[:, 1], then[:, 1]))
        share = (row - first[:, 1]) / np.where(then[:, 1] == first[:, 1], 1.0, then[:, 1] - first[:, 1])
        u = first[:, 0] + share * (then[:, 0] - first[:, 0])
        good = seen[:-1] & seen[1:] & (face[:-1] == face[1:]) & (share >= 0) & (share <= 1)
        good &= (u >= 0) & (u <= camera.width - 1) & (row >= 0) & (row <= camera.height - 1)
        centre[k, row[good].astype(int)] = u[good]
        valid[k, row[good].astype(int)] = True
    noise = noise_px * rng.normal(size=centre.shape)
    return SweepStripes(
        name=f"sweep{station}",
        centre=np.where(valid, centre + noise, 0.0).astype(np.float32),
        sigma=np.where(valid, noise_px, 0.0).astype(np.float32),
        shared_lines=np.ones_like(centre, np.float32),
        valid=valid,
        record=np.arange(steps),
        laser=np.zeros(steps, np.int32),
        angle=angle,
        stripe_axis="rows",
        station=station,
    )
