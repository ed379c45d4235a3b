"""What stands before the scanner: a wall with printed marks, the hall of the acceptance tests, a vase and a globe.

The hall has calibrated spheres, dumb-bells and plates round the scanner, in its frame: the table's axis is z, and the
camera looks along x at angle 0. Its walls are parallel to x and y. Targets hang without stands, which would hide a part
of them."""

from functools import partial
from typing import NamedTuple

import numpy as np

from jaxscan.simulation import LightSpec, Motion, RoomSpec, SimulationConfig, make_rig
from jaxscan.simulation.scene.meshes import Mesh, Surface
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


HALL = RoomSpec(size_m=(7.2, 7.2, 2.6), rig_m=(3.6, 3.6, 1.3), yaw_deg=0.0, furniture=False)
BAR_M = 0.5
"""Calibrated length of a dumb-bell."""
_SIDES = 200
"""Of the polyhedron of a sphere: the facets of one of 150 mm lie at most 0.02 mm inside of it."""
_MATT = Material(((0.74, 0.74, 0.72),))
_ROD = Material(((0.20, 0.20, 0.20),))
_ROD_RADIUS = 0.008


class Ball(NamedTuple):
    """A sphere."""

    name: str
    centre: tuple[float, float, float]
    """m, scanner frame."""
    diameter: float
    """m."""


class Plate(NamedTuple):
    """A flat plate of 0.5 x 1 m."""

    name: str
    centre: np.ndarray
    """[3], m, scanner frame."""
    edges: np.ndarray
    """Its edges [2, 3], m."""


class Length(NamedTuple):
    """A calibrated distance between the centres of two spheres."""

    test: str
    """ "bar": of a dumb-bell; "across": over the whole room; "front": at one azimuth."""
    name: str
    first: str
    second: str


class Hall(NamedTuple):
    """All targets."""

    balls: dict[str, Ball]
    plates: list[Plate]
    lengths: list[Length]

    def true_length(self, length: Length) -> float:
        """Its calibrated value [m]."""
        ends = [np.array(self.balls[name].centre) for name in (length.first, length.second)]
        return float(np.linalg.norm(ends[1] - ends[0]))

    def around(self, azimuth: float, reach: float) -> "Hall":
        """The targets whose middle lies within an angle of an azimuth: fewer fine meshes are rendered sooner.

        Args:
            azimuth: In the scanner frame [deg].
            reach: The angle [deg].
        """

        def inside(point: np.ndarray | tuple[float, ...]) -> bool:
            turn = np.rad2deg(np.arctan2(point[1], point[0])) - azimuth
            return bool(abs((turn + 180) % 360 - 180) < reach)

        balls = {name: ball for name, ball in self.balls.items() if inside(ball.centre)}
        lengths = [one for one in self.lengths if {one.first, one.second} <= balls.keys()]
        return Hall(balls, [plate for plate in self.plates if inside(plate.centre)], lengths)

    def build(self, mesh: Mesh) -> None:
        """Add the targets to the mesh of the hall, in the coordinates of the room."""
        shift = np.array(HALL.rig_m)
        for ball in self.balls.values():
            _sphere(mesh, shift + ball.centre, ball.diameter / 2)
        for plate in self.plates:
            mesh.quad(shift + plate.centre - plate.edges.sum(0) / 2, *plate.edges, _MATT)
        for length in self.lengths:
            if length.test == "bar":
                _rod(mesh, *(shift + self.balls[name].centre for name in (length.first, length.second)))


def hall_config(config: SimulationConfig) -> SimulationConfig:
    """The same rig in the empty hall, whose lamp throws no shadows."""
    light = LightSpec(**{**config.light.model_dump(), "shadows": False})
    return config.model_copy(update={"room": HALL, "light": light})


def make_hall(*, quick: bool) -> Hall:
    """The targets; if `quick`, only some of each kind."""
    balls, lengths = _stacks(quick)
    for number, (azimuth, distance, along) in enumerate(_BARS[:2] if quick else _BARS, 1):
        middle = _place(azimuth, distance, 0.0)
        half = BAR_M / 2 * np.array(along) / np.linalg.norm(along) @ _frame(azimuth)
        ends = [
            Ball(f"bar {number}{side}", _plain(middle + sign * half), 0.125) for sign, side in ((-1, "a"), (1, "b"))
        ]
        balls += ends
        lengths.append(Length("bar", f"bar {number}", ends[0].name, ends[1].name))
    for azimuth, distance, diameter in _SINGLE[:2] if quick else _SINGLE:
        balls.append(Ball(f"single {distance:g} m", _plain(_place(azimuth, distance, 0.0)), diameter))
    plates = [_plate(number, pose) for number, pose in enumerate(_PLATES[:1] if quick else _PLATES, 1)]
    return Hall({ball.name: ball for ball in balls}, plates, lengths)


_SINGLE = (
    (209.0, 1.0, 0.100),
    (135.0, 3.0, 0.150),
    (47.0, 4.0, 0.150),
    (221.0, 1.25, 0.100),
    (306.0, 2.0, 0.125),
    (316.0, 3.5, 0.150),
    (331.0, 1.5, 0.100),
    (345.0, 2.5, 0.150),
    (149.0, 1.75, 0.125),
    (142.0, 2.25, 0.150),
)
"""Azimuth [deg], distance from the axis [m] and diameter [m] of ten spheres."""
_BARS = (
    (13.0, 2.40, (0, 1, 0)),
    (25.0, 2.40, (0, 0, 1)),
    (35.0, 2.35, (0, 1, 1)),
    (102.0, 2.35, (0, 1, -1)),
    (115.0, 2.10, (0.8, 0, 0.6)),
    (126.0, 2.10, (0.7, 0.7, 0)),
    (192.0, 2.15, (1, 1, 1)),
)
"""Azimuth [deg], distance [m] and direction (away, sideways, up) of the seven dumb-bells, to 2.5 m at most."""
_PLATES = (
    (62.0, 0.0, 0.0, 0.0),
    (166.0, 0.0, 0.0, 90.0),
    (77.0, 35.0, 0.0, 0.0),
    (238.0, -35.0, 0.0, 0.0),
    (254.0, 0.0, 30.0, 0.0),
    (289.0, 20.0, 20.0, 30.0),
)
"""Azimuth, and turns about the vertical, the level and the plate's own normal [deg]; their middles are 2.5 m away."""
_STACKS = ((0.0, 2.9), (90.0, 2.1), (180.0, 2.9), (270.0, 2.1))
"""Azimuth [deg] and distance [m] of three spheres above each other: the lengths across the room are 5.8 and 4.2 m."""
_LEVELS = {"top": 0.2, "middle": 0.0, "bottom": -0.2}
"""Height of those spheres as a share of their distance: the image ends at about 0.28 of the depth."""


def _stacks(quick: bool) -> tuple[list[Ball], list[Length]]:
    """Spheres at four azimuths, and lengths between them: level, upright and both diagonals."""
    stacks = _STACKS[::2] if quick else _STACKS
    levels = [name for name in _LEVELS if not quick or name != "middle"]
    balls = [
        Ball(f"{azimuth:g} {level}", _plain(_place(azimuth, distance, _LEVELS[level] * distance)), 0.150)
        for azimuth, distance in stacks
        for level in levels
    ]
    pairs = [(first, second) for first in levels for second in levels]
    opposite = [(a, b) for a, _ in stacks for b, _ in stacks if b - a == 180]
    lengths = [
        Length("across", f"{a:g} {first} to {b:g} {second}", f"{a:g} {first}", f"{b:g} {second}")
        for a, b in opposite
        for first, second in pairs
    ]
    lengths += [
        Length("front", f"{azimuth:g} upright", f"{azimuth:g} top", f"{azimuth:g} bottom") for azimuth, _ in stacks
    ]
    return balls, lengths


def _plate(number: int, pose: tuple[float, float, float, float]) -> Plate:
    azimuth, *turns = pose
    about_up, about_level, about_normal = np.deg2rad(turns)
    away, sideways, up = _frame(azimuth)
    sideways, away = (
        np.cos(about_up) * sideways + np.sin(about_up) * away,
        np.cos(about_up) * away - np.sin(about_up) * sideways,
    )
    up = np.cos(about_level) * up + np.sin(about_level) * away
    c, s = np.cos(about_normal), np.sin(about_normal)
    return Plate(
        f"plate {number}", _place(azimuth, 2.5, 0.0), np.stack([0.5 * (c * sideways + s * up), c * up - s * sideways])
    )


def _frame(azimuth: float) -> np.ndarray:
    """Unit vectors away from the axis, sideways and up [3, 3]."""
    c, s = np.cos(np.deg2rad(azimuth)), np.sin(np.deg2rad(azimuth))
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def _place(azimuth: float, distance: float, height: float) -> np.ndarray:
    return distance * _frame(azimuth)[0] + np.array([0.0, 0.0, height])


def _plain(point: np.ndarray) -> tuple[float, float, float]:
    x, y, z = map(float, point)
    return x, y, z


def _sphere(mesh: Mesh, centre: np.ndarray, radius: float) -> None:
    """The side of a ball that the scanner sees: within 110 degrees of the direction to it."""
    angle = np.linspace(0.0, np.deg2rad(110.0), round(110 / 360 * _SIDES) + 1)
    ball = Mesh()
    ball.lathe((0, 0, 0), radius * np.stack([np.sin(angle), np.cos(angle)], -1), _MATT, sides=_SIDES)
    way = np.array(HALL.rig_m) - centre
    way /= np.linalg.norm(way)
    side = np.cross([0.0, 0.0, 1.0], way)
    side /= np.linalg.norm(side)
    turn = np.stack([side, np.cross(way, side), way], 1)
    mesh.add(centre + ball.triangles[0] @ turn.T, Surface(_MATT, centre, turn[:, 0], turn[:, 1]))


def _rod(mesh: Mesh, a: np.ndarray, b: np.ndarray) -> None:
    """A thin dark rod with twelve sides."""
    along = (b - a) / np.linalg.norm(b - a)
    first = np.cross(along, [0.3, 0.5, 0.8])
    first /= np.linalg.norm(first)
    angle = np.linspace(0, 2 * np.pi, 13)
    ring = _ROD_RADIUS * (np.outer(np.cos(angle), first) + np.outer(np.sin(angle), np.cross(along, first)))
    low, high = a + ring, b + ring
    halves = ([low[:-1], low[1:], high[1:]], [low[:-1], high[1:], high[:-1]])
    mesh.add(np.concatenate([np.stack(half, 1) for half in halves]), Surface(_ROD, a, first, along))


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
