"""The truth of a simulated rig, for comparison with estimates; never an input of one."""

from typing import Any, cast

import jax
import numpy as np

from jaxscan.geometry import CAMERAS, LaserSheet, Scanner, Turntable, stack_lasers
from jaxscan.geometry.scanner import UP_VECTORS
from jaxscan.simulation.rig import Motion, make_rig
from jaxscan.simulation.scene import room_from_scanner
from jaxscan.simulation.settings import RoomSpec, SimulationConfig, TurntableSpec


def true_scanner(config: SimulationConfig) -> Scanner:
    """The scanner of a perfect calibration of this rig, without covariance."""
    table = config.turntable
    sheets = []
    for laser in config.laser:
        flat = LaserSheet.from_plane(*laser.plane())
        sheets.append(LaserSheet(flat.normal, flat.distance, np.array(laser.bow), flat.basis))
    camera = config.camera
    fx, fy, cx, cy = (np.asarray(value) for value in (camera.fx, camera.fy, *camera.centre()))
    lens = np.array(list(camera.coefficients().values()))
    axis = _axis(table).pointed(np.array(UP_VECTORS[camera.up]))
    turntable = Turntable(
        axis.direction, axis.point, np.asarray(table.gain), np.array(table.harmonics), axis.basis, table.carries
    )
    return Scanner(
        camera=CAMERAS[camera.model](fx, fy, cx, cy, lens, camera.width, camera.height),
        lasers=stack_lasers(sheets),
        turntable=turntable,
        laser_names=tuple(laser.name for laser in config.laser),
        up=camera.up,
    )


def truth(config: SimulationConfig) -> dict[str, Any]:
    """The truth as a dictionary ready for JSON, format "jaxscan-truth/1".

    Holds the scanner's parameters by the names of `Scanner.parameter_names()` (those of a
    direction are 0 by definition, so directions are given whole), and, for a room, its size, its
    wall planes `normal . p = distance` in the scanner frame (normals into the room) and a few
    lengths.
    """
    rig = make_rig(config)
    scanner = true_scanner(config)
    lasers = [
        {
            "name": sheet.spec.name,
            "normal": _plain(sheet.normal),
            "distance_m": sheet.distance,
            "bow": list(sheet.spec.bow),
        }
        for sheet in rig.sheets
    ]
    out: dict[str, Any] = {
        "format": "jaxscan-truth/1",
        "seed": config.seed,
        "parameters": {name: _plain(value) for name, value in _parameters(scanner).items()},
        "lasers": lasers,
        "turntable": {
            "carries": config.turntable.carries,
            "direction": _plain(rig.direction),
            "point_m": _plain(rig.point),
            "gain": config.turntable.gain,
            "harmonics": list(config.turntable.harmonics),
        },
    }
    if config.room is not None:
        room, motion = config.room, room_from_scanner(config)
        out["room"] = {
            "size_m": list(room.size_m),
            "planes": _planes(room, motion),
            "distances": _distances(room, motion.inverse()),
        }
    return out


def _axis(spec: TurntableSpec) -> Turntable:
    if spec.tr is None:
        return Turntable.from_axis(np.array(spec.direction), np.array(spec.point_m))
    tr = np.array(spec.tr)
    tr[:3, 3] /= 1000
    return Turntable.from_tr(tr)


def _parameters(scanner: Scanner) -> dict[str, Any]:
    """Values of the minimal coordinates; a tangent coordinate is 0 at its own base point."""
    # Simulated rigs have a table.
    camera, table = scanner.camera, cast(Turntable, scanner.turntable)
    values: dict[str, Any] = dict.fromkeys(scanner.parameter_names(), 0.0)
    values |= dict(zip(camera.parameter_names(), np.asarray(camera.parameters()), strict=True))
    for index, name in enumerate(scanner.laser_names):
        sheet = jax.tree.map(lambda leaf, index=index: leaf[index], scanner.lasers)
        values |= {
            f"laser.{name}.d": sheet.distance,
            f"laser.{name}.b2": sheet.bow[0],
            f"laser.{name}.b3": sheet.bow[1],
        }
    values["gain"] = table.gain
    values |= dict(zip(("c1", "s1", "c2", "s2"), np.asarray(table.harmonics), strict=True))
    return values


def _planes(room: RoomSpec, motion: Motion) -> list[dict[str, Any]]:
    """Walls, floor and ceiling, by the motion from the scanner to the room."""
    planes = []
    for axis, (low, high) in enumerate((("wall x0", "wall x1"), ("wall y0", "wall y1"), ("floor", "ceiling"))):
        for name, sign, at in ((low, 1.0, 0.0), (high, -1.0, room.size_m[axis])):
            normal = np.zeros(3)
            normal[axis] = sign
            # n . (R p + t) = sign at
            distance = sign * at - normal @ motion.translation
            planes.append({"name": name, "normal": _plain(motion.rotation.T @ normal), "distance_m": float(distance)})
    return planes


def _distances(room: RoomSpec, motion: Motion) -> list[dict[str, Any]]:
    """Lengths between points in the scanner frame, by the motion from the room to the scanner."""
    x, y, z = room.size_m
    pairs = {
        "length along x": ((0, y / 2, z / 2), (x, y / 2, z / 2)),
        "length along y": ((x / 2, 0, z / 2), (x / 2, y, z / 2)),
        "height": ((x / 2, y / 2, 0), (x / 2, y / 2, z)),
        "diagonal of the floor": ((0, 0, 0), (x, y, 0)),
    }
    return [
        {
            "name": name,
            "from_m": _plain(motion.apply(np.array(a, float))),
            "to_m": _plain(motion.apply(np.array(b, float))),
            "distance_m": float(np.linalg.norm(np.subtract(a, b))),
        }
        for name, (a, b) in pairs.items()
    ]


def _plain(value: Any) -> Any:
    return np.asarray(value, np.float64).tolist()
