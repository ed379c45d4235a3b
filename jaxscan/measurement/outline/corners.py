r"""Corners as intersections of planes, and the uncertainty of what is computed from them.

Each plane may be displaced along its normal by $h(x) \cdot (\mathrm{offset}, \mathrm{slopes})$, linear in the place x.
A corner x of three planes with normals N moves by $N^{-1} (h_1(x) \cdot s_1, h_2(x) \cdot s_2, h_3(x) \cdot s_3)$, so a
number that depends on corners is, to first order, a weighted sum of the planes' parameters, and these are weighted sums
of points.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from jaxscan.geometry import Scanner
from jaxscan.measurement.outline.level import Frame
from jaxscan.measurement.planes import Plane
from jaxscan.measurement.samples import Places, is_known
from jaxscan.measurement.systematic import Effects, effects_of
from jaxscan.measurement.walls import Wall, wall_weights


@dataclass(frozen=True)
class Estimate:
    """A measured number and its standard deviations, in metres, square metres or cubic metres."""

    value: float
    sigma: float
    sigma_random: float
    """The part from the scatter of the points."""
    sigma_systematic: float
    """The part from the covariances of the calibration and of the poses of stations; 0 where they are not known."""

    @property
    def known(self) -> bool:
        """Whether it may be stated as a dimension."""
        return is_known(self.value, self.sigma)


class Surface(NamedTuple):
    """A plane that bounds something, and the points behind it; None for one that is given and has no error."""

    plane: Plane
    wall: Wall | None

    @staticmethod
    def exact(normal: np.ndarray, distance: float) -> "Surface":
        """The plane `normal . p = distance` without error; unit normal [3], distance [m]."""
        axes = np.linalg.svd(normal[None])[2][1:]
        return Surface(Plane(normal, distance, distance * normal, axes, np.zeros((3, 3))), None)

    def raised(self, height: float) -> "Surface":
        """The surface moved against its normal by a height [m], with the same errors."""
        plane = self.plane
        moved = plane._replace(distance=plane.distance - height, centre=plane.centre - height * plane.normal)
        return Surface(moved, self.wall)


class Corner(NamedTuple):
    """Where three surfaces meet [3], m."""

    at: np.ndarray
    surfaces: tuple[Surface, Surface, Surface]

    def effects(self, gradient: np.ndarray) -> list[tuple[Surface, np.ndarray]]:
        """Weights [3] of each surface's (offset, slopes) in a number that has this gradient [3] by the corner."""
        shares = np.linalg.solve(np.stack([surface.plane.normal for surface in self.surfaces]).T, gradient)
        return [
            (surface, share * surface.plane.height_weights(self.at))
            for surface, share in zip(self.surfaces, shares, strict=True)
        ]


def corner_of(*surfaces: Surface) -> Corner:
    """The corner of three surfaces that are not parallel."""
    first, second, third = surfaces
    normals = np.stack([surface.plane.normal for surface in surfaces])
    at = np.linalg.solve(normals, np.array([surface.plane.distance for surface in surfaces]))
    return Corner(at, (first, second, third))


@dataclass(frozen=True)
class Errors:
    """What is known of the errors of a cloud's points, in the frame of a plan."""

    scanner: Scanner | None
    places: Places
    frame: Frame
    known: dict[int, tuple[Wall, Effects]] = field(default_factory=dict)
    """Effects of scanner and stations in (offset, slopes) of walls, by their identity: many numbers share a wall."""

    def estimate(self, value: float, effects: Sequence[tuple[Surface, np.ndarray]]) -> Estimate:
        """A number with its sigmas, by surfaces and the weights [3] of their (offset, slopes) in it."""
        rows: dict[int, tuple[Wall, np.ndarray]] = {}
        for surface, row in effects:
            if surface.wall is not None:
                _, before = rows.get(id(surface.wall), (surface.wall, np.zeros(3)))
                rows[id(surface.wall)] = surface.wall, before + row
        if not rows:
            return Estimate(value, 0.0, 0.0, 0.0)
        random = sum(float(row @ wall.plane.covariance @ row) for wall, row in rows.values())
        systematic = 0.0
        if self.scanner is not None or self.places.covariance.any():
            parts = [self._effects(wall).weighted(row) for wall, row in rows.values()]
            systematic = functools.reduce(Effects.plus, parts).sigma(self.scanner, self.places)
        return Estimate(value, float(np.hypot(np.sqrt(random), systematic)), float(np.sqrt(random)), systematic)

    def _effects(self, wall: Wall) -> Effects:
        if id(wall) not in self.known:
            part, weights = wall_weights(wall, np.eye(3))
            in_cloud = part._replace(p=self.frame.back(part.p), origin=self.frame.back(part.origin))
            found = effects_of(self.scanner, self.places, in_cloud, weights @ self.frame.rotation)
            # With the wall, so that its identity stays its own.
            self.known[id(wall)] = wall, found
        return self.known[id(wall)][1]


def length_between(start: Corner, end: Corner, errors: Errors) -> Estimate:
    """The distance of two corners [m]."""
    apart = end.at - start.at
    value = float(np.linalg.norm(apart))
    along = apart / value
    return errors.estimate(value, [*start.effects(-along), *end.effects(along)])


def area_of(loops: Sequence[Sequence[Corner]], normal: np.ndarray, errors: Errors) -> Estimate:
    """The area of a flat polygon [m^2]; loops are right-handed about the unit normal [3], holes left-handed."""
    value, effects = 0.0, []
    for loop in loops:
        at = np.array([corner.at for corner in loop])
        before, after = np.roll(at, 1, 0), np.roll(at, -1, 0)
        value += 0.5 * float(np.cross(at, after).sum(0) @ normal)
        gradient = 0.5 * np.cross(after - before, normal)
        effects += [each for corner, row in zip(loop, gradient, strict=True) for each in corner.effects(row)]
    return errors.estimate(value, effects)
