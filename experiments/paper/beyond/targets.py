"""The hall of the acceptance tests: calibrated spheres, dumb-bells and plates round the scanner.

Coordinates are those of the scanner frame: the table's axis is z, and the camera looks along x at angle 0. The hall is
placed so that its walls are parallel to x and y. Targets hang without stands, which would hide a part of them.
"""

from typing import NamedTuple

import numpy as np

from jaxscan.simulation import LightSpec, RoomSpec, SimulationConfig
from jaxscan.simulation.scene.meshes import Mesh, Surface
from jaxscan.simulation.scene.textures import Material


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
