"""A cloud as it is shown: in the order of its levels, with its colours and the place where it stands."""

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from jaxscan.errors import CloudError
from jaxscan.measurement import PlaneMeasurement
from jaxscan.reconstruction import PointCloud, some_points
from jaxscan.surface import faces_of_cloud, mesh_grid
from jaxscan.viewer.colours import UNKNOWN, Colouring, Scale, brightened, coloured_normals, scale_of
from jaxscan.viewer.levels import Levels, make_levels
from jaxscan.viewer.sides import gridded_normals, hides_well, sides_of, walls_of


_MM = 1e3
_AT_ONCE = 1 << 18
_DARKEST = 60.0
"""Level of the weakest points of a cloud that has intensities alone."""


def says_its_place(cloud: PointCloud) -> bool:
    """Whether a cloud says where its scanner stood: by a pose, or by angles of a table."""
    return cloud.stations is not None or bool(np.ptp(np.asarray(cloud.angle)) > 0)


def knows_its_place(cloud: PointCloud) -> bool:
    """Whether a cloud says where its scanner stood, or has it in an origin amid the points."""
    if says_its_place(cloud):
        return True
    low, high = np.percentile(some_points(cloud, 1_000_000), [1, 99], axis=0)
    return bool(((low < 0) & (high > 0)).all())


def middle_of(cloud: PointCloud) -> np.ndarray:
    """A place amid a cloud [3], in whole metres: one on a map has more digits than a browser's numbers."""
    return np.round(np.median(some_points(cloud, 10_000), 0))


def _taken(values: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Values at an index [n]. NumPy would make a copy of it in 64 bits, twice as large: here of a part at a time."""
    found = np.empty((len(index), *values.shape[1:]), values.dtype)
    for start in range(0, len(index), _AT_ONCE):
        found[start : start + _AT_ONCE] = values[index[start : start + _AT_ONCE]]
    return found


class ShownCloud:
    """A cloud of the scene. Its frame there is its own, less `origin`, which keeps numbers small on a map."""

    def __init__(
        self,
        name: str,
        cloud: PointCloud,
        origin: np.ndarray,
        *,
        turned: bool = False,
        words: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        """Sort the points of a cloud in metres, z up, with one valid point at least.

        Args:
            name: As people know it.
            cloud: Points.
            origin: Place in the cloud's frame that is the origin of the scene, float64 [3], m.
            turned: Whether the axes are not those of its file.
            words: Options by which `jaxscan measure` measures the same: "calibration", "unit" and "up".
        """
        self.name, self.cloud, self.origin, self.turned = name, cloud, origin, turned
        self.words = words
        number = np.int32 if cloud.valid.size < 2**31 else np.int64
        cells = np.flatnonzero(np.asarray(cloud.valid)).astype(number)
        flat = np.asarray(cloud.xyz).reshape(-1, 3)
        xyz = _taken(flat, cells)
        xyz -= origin.astype(flat.dtype)
        xyz = xyz.astype(np.float32, copy=False)
        self.levels: Levels = make_levels(xyz)
        self.xyz = _taken(xyz, self.levels.order)
        """Points in the scene's frame, in the order in which they are shown, float32 [n, 3]."""
        del xyz
        self.cells = _taken(cells, self.levels.order)
        """Their places on the cloud's grid, counted line after line."""
        del cells
        some = self.xyz[:: max(1, len(self.xyz) // 50_000)]
        self.low, self.high = np.percentile(some, [1, 99], axis=0)
        """Corners of the points without their outermost hundredth, in the scene's frame [3], m."""
        self.sides = self._sides()
        """From which side the points were seen, int8 [n, 3]; None where the cloud does not know."""
        self.hides = self.sides is not None and hides_well(self.sides)
        """Whether what is seen from behind is better left out at first."""
        self.walls = None if self.sides is None else walls_of(self.sides)
        """Angle about z from the axes to the walls [rad]; None where it is unknown."""

    @property
    def points(self) -> int:
        """How many there are."""
        return len(self.xyz)

    def has(self, by: Colouring) -> bool:
        """Whether the cloud knows what the colours would show."""
        if by in ("height", "deviation"):
            return True
        field = {
            "photograph": self.cloud.rgb,
            "intensity": self.cloud.intensity,
            "normals": self.cloud.normals,
            "sigma": self.cloud.sigma_random,
        }[by]
        return bool(np.any(np.asarray(field)))

    def take(self, field: ArrayLike, some: slice = slice(None)) -> np.ndarray:
        """A field of the cloud at its points or some of them, in the order in which they are shown."""
        values = np.asarray(field)
        return _taken(values.reshape(-1, *values.shape[2:]), self.cells[some])

    def coloured(self, by: Colouring, *, plane: PlaneMeasurement | None) -> tuple[np.ndarray, Scale | None]:
        """The colours of its points, and their scale where they have one; deviations are those from a plane.

        As photographed where the cloud does not know what the colours show, and grey where it has no colours.
        """
        if by == "deviation" and plane is not None:
            return self._deviations(plane)
        if by in ("photograph", "deviation") or not self.has(by):
            # Black points would be invisible on the dark background.
            return brightened(self.take(self.cloud.rgb)) if self.has("photograph") else self._grey(), None
        if by == "normals":
            return coloured_normals(self.take(self.cloud.normals)), None
        if by == "height":
            values, unit = self.xyz[:, 2] + np.float32(self.origin[2]), "m"
        elif by == "intensity":
            values, unit = self.take(self.cloud.intensity), "DN"
        else:
            parts = (self.take(self.cloud.sigma_random), self.take(self.cloud.sigma_systematic))
            values, unit = _MM * np.hypot(*parts), "mm"
            known = values > 0
            scale = scale_of(values[known], unit)
            return np.where(known[:, None], scale.coloured(values), UNKNOWN), scale
        scale = scale_of(values, unit)
        return scale.coloured(values), scale

    def _grey(self) -> np.ndarray:
        if not self.has("intensity"):
            return np.broadcast_to(UNKNOWN, (self.points, 3)).copy()
        levels = self.take(self.cloud.intensity)
        scale = scale_of(levels, "DN")
        grey = np.clip((levels - scale.low) / max(scale.high - scale.low, 1e-12), 0.0, 1.0)
        return np.repeat((_DARKEST + (255 - _DARKEST) * grey).astype(np.uint8)[:, None], 3, axis=1)

    def _deviations(self, plane: PlaneMeasurement) -> tuple[np.ndarray, Scale]:
        offset = float((plane.centre_m - self.origin) @ plane.normal)
        values = _MM * (self.xyz @ plane.normal.astype(np.float32) - np.float32(offset))
        # The scale is that of the plane itself, not of what stands in front of it.
        scale = Scale(-_MM * 3 * plane.range95_m, _MM * 3 * plane.range95_m, "mm", diverging=True)
        return scale.coloured(values), scale

    def around(self, places: np.ndarray, radius_m: float, least: int) -> PointCloud:
        """The cloud with only the points around places [k, 3], so that a measurement reads few.

        The whole cloud where a place has fewer than `least` points around it: a measurement then says so.
        """
        valid = np.zeros(self.cloud.valid.shape, bool)
        # Rounding moves points by less than this.
        reach = radius_m + 1e-3
        for place in np.asarray(places, np.float64) - self.origin:
            near = np.flatnonzero((np.abs(self.xyz - place.astype(np.float32)) <= reach).all(1))
            if len(near) < least:
                return self.cloud
            valid.reshape(-1)[self.cells[near]] = True
        return dataclasses.replace(self.cloud, valid=valid)

    def stations(self) -> np.ndarray:
        """Where the scanner stood, [k, 3], m, in the scene's frame; none where that is unknown."""
        if self.cloud.stations is None:
            return np.asarray(-self.origin[None][: int(knows_its_place(self.cloud))])
        return np.asarray(np.asarray(self.cloud.stations.pose)[:, :3, 3] - self.origin)

    def _sides(self) -> np.ndarray | None:
        normals = self.cloud.normals if self.has("normals") else self._gridded()
        # Most clouds of other programs have none, and taking them takes as much memory as the points.
        if not np.any(np.asarray(normals)):
            return None
        seen = lambda some: (self.take(normals, some), self._towards(some))
        return sides_of(seen, self.points, certain=says_its_place(self.cloud))

    def _towards(self, some: slice) -> np.ndarray | None:
        """Vectors from some points to their scanner, [n, 3], m; None where its place is unknown."""
        places = self.stations().astype(np.float32)
        if not len(places):
            return None
        if self.cloud.stations is None:
            return np.asarray(places[0] - self.xyz[some])
        lines = self.cloud.valid.shape[1]
        return np.asarray(places[np.asarray(self.cloud.stations.number)[self.cells[some] // lines]] - self.xyz[some])

    def _gridded(self) -> ArrayLike:
        """Normals of a cloud without any, by its grid; zero where it has none."""
        places = self.stations() + self.origin
        if not len(places):
            return self.cloud.normals
        numbers = 0 if self.cloud.stations is None else np.asarray(self.cloud.stations.number)
        found = gridded_normals(self.cloud, np.broadcast_to(places[numbers], (len(self.cloud.valid), 3)))
        return self.cloud.normals if found is None else found

    def axes(self) -> list[list[float]]:
        """The axes of the scanner at the first station, in the scene's frame [axis, 3]."""
        turn = np.eye(3) if self.cloud.stations is None else np.asarray(self.cloud.stations.pose)[0, :3, :3]
        return np.asarray(turn, np.float64).T.tolist()


_MOST_POINTS = 3_000_000


class Surface(NamedTuple):
    """Triangles between neighbours of the grid that are on one surface."""

    points: np.ndarray
    """The point of each corner, in the order in which they are shown, int [n]."""
    faces: np.ndarray
    """Corners of each triangle, anticlockwise as the scanner saw them, uint32 [m, 3]."""


def has_grid(shown: ShownCloud) -> bool:
    """Whether a cloud has a grid on which neighbours may be joined."""
    cloud = shown.cloud
    return min(cloud.valid.shape) > 1 and bool(np.ptp(np.asarray(cloud.angle)) > 0) and shown.points <= _MOST_POINTS


def surface_of(shown: ShownCloud) -> Surface:
    """Join the neighbours of a cloud's grid, as `jaxscan mesh` does.

    Raises:
        CloudError: If it has no grid, or no neighbours are on one surface.
    """
    if not has_grid(shown):
        raise CloudError(f"{shown.name}: has no surface to show: it needs a grid, and 3 million points at most.")
    places, faces = faces_of_cloud(mesh_grid(shown.cloud))
    number = np.zeros(shown.cloud.valid.size, np.int32)
    number[shown.cells] = np.arange(shown.points, dtype=np.int32)
    return Surface(number[places], faces.astype("<u4"))


def surface_bytes(shown: ShownCloud, surface: Surface) -> bytes:
    """Counts of corners and triangles, uint32; places about the scene's origin, float32; normals, int8 with a fourth
    byte each; triangles, uint32.
    """
    normals = np.zeros((len(surface.points), 4), np.int8)
    normals[:, :3] = np.rint(127 * np.clip(shown.take(shown.cloud.normals)[surface.points], -1, 1))
    counts = np.array([len(surface.points), len(surface.faces)], "<u4")
    parts = (counts, shown.xyz[surface.points].astype("<f4"), normals, surface.faces)
    return b"".join(np.ascontiguousarray(part).tobytes() for part in parts)
