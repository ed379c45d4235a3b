"""A flat wall with printed marks on a square grid, seen across a bare hall."""

import numpy as np

from jaxscan.simulation import Motion, RoomSpec, SimulationConfig, make_rig
from jaxscan.simulation.scene import Material, Mesh
from jaxscan.simulation.scene.textures import Blend


DISTANCE_M = 2.5
"""From the camera to the wall, when it looks straight at it: the paper's "about 2.5 m"."""
PITCH_M = 0.15
"""Pitch of the grid: second neighbours are 300 mm apart."""
RADIUS_M = 0.025
"""Radius of a mark, a dark disc."""
EDGE_M = 0.001
"""Width of a print's edge. The renderer looks at the middle of a pixel, about 0.9 mm wide here: a wider edge is not
cut into steps."""
ROWS = 9
_HALL = (7.0, 5.6, 3.0)
_RIG = (3.5, 1.5, 1.4)


def hall(config: SimulationConfig) -> SimulationConfig:
    """The rig in a hall without furniture; at angle 0 it looks along y."""
    room = RoomSpec(size_m=_HALL, rig_m=_RIG, yaw_deg=90.0, furniture=False)
    return config.model_copy(update={"room": room, "light": config.light.model_copy(update={"shadows": False})})


def wall_distance(config: SimulationConfig) -> float:
    """Distance of the wall from the table's axis [m]."""
    camera: Motion = make_rig(hall(config)).pose(0.0)
    return DISTANCE_M + float(camera.translation[0])


def wall(distance: float, columns: int, mesh: Mesh) -> None:
    """Add the wall, as wide as the hall, with `columns` x `ROWS` marks round the height of the rig."""
    x, y, height = _RIG
    half_u, half_v = (columns - 1) / 2, (ROWS - 1) / 2

    def marks(u: np.ndarray, v: np.ndarray) -> Blend:
        across, up = (u - np.float32(x)) / PITCH_M, (v - np.float32(height)) / PITCH_M
        column = np.clip(np.rint(across - half_u % 1) + half_u % 1, -half_u, half_u)
        row = np.clip(np.rint(up - half_v % 1) + half_v % 1, -half_v, half_v)
        apart = np.hypot(across - column, up - row) * PITCH_M
        ink = np.clip(0.5 - (apart - RADIUS_M) / EDGE_M, 0, 1)
        return Blend(0, 1, ink.astype(np.float32), 1.0)

    paint = Material(((0.80, 0.80, 0.78), (0.30, 0.30, 0.31)), marks)
    mesh.quad(np.array([0, y + distance, 0]), np.array([_HALL[0], 0, 0]), np.array([0, 0, _HALL[2]]), paint)


def stripe_window(config: SimulationConfig, near: float, far: float) -> tuple[int, int]:
    """Columns in which the stripe of surfaces at depths `near` to `far` [m] lies: the first, and one after the last.

    From the nominal plane, a X + b Y + Z = c, with a margin of an eightieth of the width.
    """
    camera, laser = config.camera, config.laser[0]
    cx, cy = camera.centre()
    normal, distance = laser.plane()
    y = (np.array([0, camera.height - 1]) - cy) / camera.fy
    x = [(distance / depth - normal[2] - normal[1] * each) / normal[0] for depth in (near, far) for each in y]
    margin = camera.width / 80
    low, high = cx + camera.fx * min(x) - margin, cx + camera.fx * max(x) + margin
    return max(int(low), 0), min(int(np.ceil(high)) + 1, camera.width)
