"""What stands before the scanner: a wall with printed marks, and a vase and a globe on a table."""

from functools import partial

import numpy as np

from jaxscan.simulation import Motion, RoomSpec, SimulationConfig, make_rig
from jaxscan.simulation.scene.meshes import Mesh
from jaxscan.simulation.scene.textures import Blend, Material, wood


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
_MARKS_HALL = (7.0, 5.6, 3.0)
_MARKS_RIG = (3.5, 1.5, 1.4)


def marks_hall(config: SimulationConfig) -> SimulationConfig:
    """The rig in a hall without furniture; at angle 0 it looks along y."""
    room = RoomSpec(size_m=_MARKS_HALL, rig_m=_MARKS_RIG, yaw_deg=90.0, furniture=False)
    return config.model_copy(update={"room": room, "light": config.light.model_copy(update={"shadows": False})})


def wall_distance(config: SimulationConfig) -> float:
    """Distance of the wall from the table's axis [m]."""
    camera: Motion = make_rig(marks_hall(config)).pose(0.0)
    return DISTANCE_M + float(camera.translation[0])


def marks_wall(distance: float, columns: int, mesh: Mesh) -> None:
    """Add the wall, as wide as the hall, with `columns` x `ROWS` marks round the height of the rig."""
    x, y, height = _MARKS_RIG
    half_u, half_v = (columns - 1) / 2, (ROWS - 1) / 2

    def marks(u: np.ndarray, v: np.ndarray) -> Blend:
        across, up = (u - np.float32(x)) / PITCH_M, (v - np.float32(height)) / PITCH_M
        column = np.clip(np.rint(across - half_u % 1) + half_u % 1, -half_u, half_u)
        row = np.clip(np.rint(up - half_v % 1) + half_v % 1, -half_v, half_v)
        apart = np.hypot(across - column, up - row) * PITCH_M
        ink = np.clip(0.5 - (apart - RADIUS_M) / EDGE_M, 0, 1)
        return Blend(0, 1, ink.astype(np.float32), 1.0)

    paint = Material(((0.80, 0.80, 0.78), (0.30, 0.30, 0.31)), marks)
    mesh.quad(np.array([0, y + distance, 0]), np.array([_MARKS_HALL[0], 0, 0]), np.array([0, 0, _MARKS_HALL[2]]), paint)


def nominal_window(config: SimulationConfig, near: float, far: float) -> tuple[int, int]:
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


_STUDIO = (5.0, 6.0, 2.6)
_STUDIO_RIG = (2.5, 1.5, 1.2)
_AHEAD = 0.21
"""From the table's axis to the camera."""
_TABLE_TOP = _STUDIO_RIG[2] - 0.26
"""Height of the table's top."""
VASE_M = (-0.115, 1.28)
"""To the right of the scanner, and from the camera."""
GLOBE_M = (0.115, 1.36)
GLOBE_RADIUS = 0.115
_STAND = 0.12
"""Height of the globe's stand."""
_VASE_HEIGHT = 0.43
PEAK_DN = 50.0
"""Peak of the stripe on a white wall at 2.5 m: low enough that near objects do not saturate [DN]."""


def studio(config: SimulationConfig) -> SimulationConfig:
    """The rig with a colour camera in a bare hall; at angle 0 it looks along y."""
    room = RoomSpec(size_m=_STUDIO, rig_m=_STUDIO_RIG, yaw_deg=90.0, furniture=False)
    laser = config.laser[0].model_copy(update={"peak_dn": PEAK_DN})
    sensor = config.sensor.model_copy(update={"pixel_format": "rgb8"})
    return config.model_copy(update={"room": room, "laser": (laser,), "sensor": sensor})


def vase_profile() -> np.ndarray:
    """Radius and height of the vase [n, 2], m."""
    height = np.linspace(0, 1, 60)
    knots = np.array([0.0, 0.1, 0.3, 0.48, 0.7, 0.82, 0.9, 1.0])
    radii = np.array([0.052, 0.066, 0.092, 0.096, 0.058, 0.036, 0.038, 0.056])
    # A smooth curve through the knots.
    wide = np.interp(height, knots, radii)
    kernel = np.exp(-0.5 * (np.arange(-6, 7) / 2.5) ** 2)
    smooth = np.convolve(np.pad(wide, 6, "edge"), kernel / kernel.sum(), "valid")
    return np.column_stack([np.append(0.0, smooth), np.append(0.0, height) * _VASE_HEIGHT])


def still_life(mesh: Mesh) -> None:
    """Add the table and both objects."""
    x, y, _ = _STUDIO_RIG
    table = Material(((0.60, 0.44, 0.28), (0.50, 0.34, 0.20)), wood)
    mesh.box((x, y + _AHEAD + 1.36, _TABLE_TOP - 0.03), (0.8, 0.62, 0.03), table)
    vase = Material(((0.86, 0.84, 0.78), (0.20, 0.30, 0.62), (0.72, 0.28, 0.18)), _ornament)
    mesh.lathe((x + VASE_M[0], y + _AHEAD + VASE_M[1], _TABLE_TOP), vase_profile(), vase, sides=96)
    centre = (x + GLOBE_M[0], y + _AHEAD + GLOBE_M[1], _TABLE_TOP + _STAND + GLOBE_RADIUS)
    colours = ((0.30, 0.50, 0.72), (0.34, 0.56, 0.24), (0.78, 0.66, 0.34), (0.90, 0.88, 0.82))
    angle = np.linspace(-np.pi / 2, np.pi / 2, 65)
    ball = GLOBE_RADIUS * np.stack([np.cos(angle), np.sin(angle)], -1)
    mesh.lathe(centre, ball, Material(colours, partial(_continents, radius=GLOBE_RADIUS)), sides=128)
    foot = np.array(
        [[0, 0], [0.075, 0], [0.07, 0.015], [0.03, 0.03], [0.018, 0.07], [0.03, 0.115], [0, _STAND + 0.004]]
    )
    stand = Material(((0.62, 0.40, 0.24), (0.52, 0.32, 0.18)), wood)
    mesh.lathe((x + GLOBE_M[0], y + _AHEAD + GLOBE_M[1], _TABLE_TOP), foot, stand, sides=64)


def _ornament(u: np.ndarray, v: np.ndarray) -> Blend:
    """Glaze: a wave of leaves between rings, in blue and red on white."""
    share = v / np.float32(_VASE_HEIGHT)
    wave = np.sin(u * np.float32(2 * np.pi / 0.055))
    leaf = np.abs(share - 0.42 - 0.045 * wave) < 0.035 + 0.025 * np.cos(u * np.float32(2 * np.pi / 0.0275))
    dot = np.hypot(_periodic(u, 0.03), v - np.float32(0.575 * _VASE_HEIGHT)) < 0.007
    rings = np.zeros(u.shape, bool)
    for place, width in ((0.06, 0.012), (0.26, 0.01), (0.29, 0.004), (0.54, 0.004), (0.62, 0.01), (0.97, 0.02)):
        rings |= np.abs(share - place) < width
    checks = (share > 0.10) & (share < 0.22)
    checks &= (np.floor(u / np.float32(0.018)) + np.floor(v / np.float32(0.0173))) % 2 == 0
    neck = (share > 0.7) & (share < 0.93) & (_periodic(u + v * np.float32(0.6), 0.022) > 0)
    blue, red = leaf | rings | neck, dot | checks
    return Blend(np.where(red, 2, np.where(blue, 1, 0)), 0, 0.0, 1.0)


def _continents(u: np.ndarray, v: np.ndarray, *, radius: float) -> Blend:
    """A globe: seas, land, deserts, ice, and lines of longitude and latitude."""
    up = np.clip(v / np.float32(radius), -1, 1)
    latitude = np.arcsin(up)
    longitude = np.arcsin(np.clip(u / np.maximum(np.float32(radius) * np.cos(latitude), 1e-6), -1, 1))
    a, b = longitude * np.float32(1.7), latitude * np.float32(1.9)
    land = np.sin(2.1 * a + 0.6) * np.cos(2.3 * b - 0.4) + 0.45 * np.sin(5.3 * a - 2.0 * b + 1.0)
    land += 0.28 * np.sin(9.1 * b + 4.0 * a) + 0.15 * np.sin(17.0 * a + 11.0 * b)
    colour = np.where(land > 0.30, np.where(np.abs(latitude - 0.15) < 0.22, 2, 1), 0)
    colour = np.where(np.abs(latitude) > 1.15, 3, colour)
    step, half = np.float32(np.pi / 12), np.float32(0.012)
    lines = np.abs(_periodic(latitude, step)) < half
    lines |= np.abs(_periodic(longitude, step)) * np.cos(latitude) < half
    return Blend(np.where(lines, 3, colour), 0, 0.0, 1.0)


def _periodic(x: np.ndarray, period: float) -> np.ndarray:
    """The distance from the nearest multiple of a period, with its sign."""
    return x - np.rint(x / np.float32(period)) * np.float32(period)
