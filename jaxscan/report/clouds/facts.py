"""Statistics of a cloud for its report: coverage by direction, sigmas by distance, doubts."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.measurement import RoomBox
from jaxscan.measurement.samples import places_of
from jaxscan.reconstruction import PointCloud, profile_doubts
from jaxscan.report.clouds.picture import is_turned


SIDES_DEG = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 9.0, 10.0, 15.0)
"""Sides of cells: parts of 180 degrees."""
POINTS_A_CELL = 8
WHOLE_SPHERE_DEG2 = 41253.0
SMALLEST_HOLE = 4


class Hole(NamedTuple):
    """Neighbouring directions without points."""

    azimuth_deg: float
    elevation_deg: float
    wide_deg: float
    high_deg: float
    area_deg2: float


@dataclass(frozen=True)
class Directions:
    """What lies in each direction from one place; the first row looks up, the first column to azimuth 180 degrees."""

    side_deg: float
    count: np.ndarray
    """Points [rows, columns]."""
    distance_m: np.ndarray
    """Median [rows, columns], m; NaN where there are no points."""
    sigma_m: np.ndarray
    """Median standard deviation of a point [rows, columns], m; NaN where none is known."""
    lowest_deg: float
    """Elevation above which all points lie but one in two hundred."""
    highest_deg: float
    """Elevation below which all points lie but one in two hundred."""

    @property
    def elevation_deg(self) -> np.ndarray:
        """Elevation of the middle of each row [rows]."""
        return 90.0 - (np.arange(len(self.count)) + 0.5) * self.side_deg

    @property
    def azimuth_deg(self) -> np.ndarray:
        """Azimuth of the middle of each column [columns]."""
        return 180.0 - (np.arange(self.count.shape[1]) + 0.5) * self.side_deg

    @property
    def band(self) -> slice:
        """The rows between the highest and the lowest point, without one point in two hundred at either end."""
        return slice(self._row(self.highest_deg), self._row(self.lowest_deg) + 1)

    def _row(self, elevation_deg: float) -> int:
        return min(max(int((90.0 - elevation_deg) / self.side_deg), 0), len(self.count) - 1)

    def share(self, *, of_band: bool) -> float:
        """Share of all directions, or of those within the band, that have points [1]."""
        rows = self.band
        weight = np.cos(np.radians(self.elevation_deg[rows]))
        share = float(weight @ (self.count[rows] > 0).mean(1) / weight.sum())
        # The band ends at its points, within its outermost cells.
        band = np.sin(np.radians(self.highest_deg)) - np.sin(np.radians(self.lowest_deg))
        return share if of_band else share * float(band) / 2

    def holes(self) -> list[Hole]:
        """The holes of the band, the largest first."""
        top = self.band.start
        found = []
        for rows, columns in _regions(self.count[self.band] == 0):
            if len(rows) < SMALLEST_HOLE:
                continue
            azimuth = np.radians(self.azimuth_deg[columns])
            elevation = self.elevation_deg[top + rows]
            area = self.side_deg**2 * np.cos(np.radians(elevation))
            found.append(
                Hole(
                    float(np.degrees(np.angle(np.exp(1j * azimuth).sum()))),
                    float(np.average(elevation, weights=area)),
                    len(np.unique(columns)) * self.side_deg,
                    len(np.unique(rows)) * self.side_deg,
                    float(area.sum()),
                )
            )
        return sorted(found, key=lambda hole: -hole.area_deg2)


def directions_of(xyz: np.ndarray, sigma_m: np.ndarray, spacing_deg: float = 0.0) -> Directions:
    """Points [n, 3], m, z up, by direction from their station; their standard deviations [n], m, are 0 where unknown.

    Cells are no smaller than the spacing of neighbouring profiles, where it is known.
    """
    far = np.linalg.norm(xyz, axis=1)
    xyz, sigma_m, far = xyz[far > 0], sigma_m[far > 0], far[far > 0]
    wanted = max(np.sqrt(WHOLE_SPHERE_DEG2 * POINTS_A_CELL / max(len(far), 1)), 1.2 * spacing_deg)
    side = next((one for one in SIDES_DEG if one >= wanted), SIDES_DEG[-1])
    shape = round(180 / side), round(360 / side)
    azimuth, elevation = np.arctan2(xyz[:, 1], xyz[:, 0]), np.arcsin(np.clip(xyz[:, 2] / far, -1, 1))
    row = np.clip((90.0 - np.degrees(elevation)) / side, 0, shape[0] - 1).astype(int)
    column = np.clip((180.0 - np.degrees(azimuth)) / side, 0, shape[1] - 1).astype(int)
    cell = row * shape[1] + column
    # Quantiles are taken at points, not between two of them.
    ends = [np.percentile(elevation, share, method="nearest") if len(elevation) else 0.0 for share in (0.5, 99.5)]
    known = sigma_m > 0
    return Directions(
        side,
        np.bincount(cell, minlength=shape[0] * shape[1]).reshape(shape),
        _medians(cell, far, shape),
        _medians(cell[known], sigma_m[known], shape),
        *(float(np.degrees(end)) for end in ends),
    )


def _medians(cell: np.ndarray, value: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """The lower median of the values of each cell; NaN without any."""
    order = np.lexsort((value, cell))
    cells, first, count = np.unique(cell[order], return_index=True, return_counts=True)
    medians = np.full(shape[0] * shape[1], np.nan)
    medians[cells] = value[order][first + (count - 1) // 2]
    return medians.reshape(shape)


def _regions(empty: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rows and columns of each connected region; the last column is beside the first."""
    # Imported here: it takes its time.
    from scipy import ndimage  # type: ignore[import-untyped]

    label, _ = ndimage.label(empty)
    for row in np.flatnonzero(empty[:, 0] & empty[:, -1]):
        label[label == label[row, -1]] = label[row, 0]
    return [(rows, columns) for rows, columns in (np.nonzero(label == one) for one in np.unique(label[empty]))]


MOST_STATIONS = 4
FAR_OFF = 100.0
"""Points farther away than this many times the median distance are strays: no picture shows them."""
BEYOND_M = 0.05
"""Points farther outside the walls than this were seen through windows or in mirrors."""
_BINS_M = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 50.0, np.inf)


@dataclass(frozen=True)
class Beside:
    """Context of a cloud for its report: notes, calibration and doubts, all of it text."""

    name: str = ""
    notes: tuple[str, ...] = ()
    calibration: tuple[tuple[str, str], ...] = ()
    doubts: tuple[str, ...] | None = None
    """Doubts about the capture; None where it was not checked."""
    left_out: str = ""
    """Stripes that gave no point, where the capture was looked at."""
    no_dimensions: str = ""


class SigmaAt(NamedTuple):
    """Statistics of the points within a range of distances."""

    nearest_m: float
    farthest_m: float
    points: int
    median_m: float
    p95_m: float


@dataclass(frozen=True)
class Facts:
    """Statistics of a cloud for its report."""

    points: int
    far_off: int
    """Stray points, which no picture shows."""
    shown: PointCloud = field(repr=False)
    turned: bool
    """Whether the cloud says at which angles its profiles were taken."""
    directions: tuple[Directions, ...]
    """For the first few stations; seen from the middle of the cloud if the scanner's position is unknown."""
    stations: int
    placed: bool
    cells: float | None
    """Part of the cells of the grid that have a point [1]; None without a grid."""
    sigma: tuple[SigmaAt, ...]
    """Sigmas by distance; empty where the cloud has no sigmas."""
    median_sigma_m: float | None
    beyond_walls: int | None
    """Points outside the walls; None where no dimension is known."""
    doubts: tuple[str, ...]
    """Profiles that contradict their neighbours."""


def facts_of(cloud: PointCloud, box: RoomBox | None = None) -> Facts:
    """What a cloud in metres, z up, tells by itself, and by the room's dimensions, where some were found.

    Raises:
        CloudError: If the cloud has no point.
    """
    valid = np.asarray(cloud.valid)
    if not valid.any():
        raise CloudError("The cloud has no valid points; there is nothing to report.")
    places = places_of(cloud)
    turned = is_turned(cloud)
    profile, line = np.nonzero(valid)
    p = np.asarray(cloud.xyz, np.float64)[profile, line]
    number = places.number[profile]
    placed = turned or cloud.stations is not None or _is_within(p, places.pose[0, :3, 3])
    if placed:
        pose = places.pose[number]
        local = np.einsum("nji,nj->ni", pose[:, :3, :3], p - pose[:, :3, 3])
    else:
        local, number = p - np.median(p, axis=0), np.zeros(len(p), int)
    far = np.linalg.norm(local, axis=1)
    stray = far > FAR_OFF * max(float(np.median(far)), 1e-9)
    sigma = _sigmas(cloud, profile, line)
    kept = valid.copy()
    kept[profile[stray], line[stray]] = False
    some = np.unique(number[~stray])[:MOST_STATIONS]
    spacing = _spacing_deg(cloud) if turned else 0.0
    chosen = [(number == one) & ~stray for one in some]
    seen = tuple(directions_of(local[mine], sigma[mine], spacing) for mine in chosen)
    known = sigma > 0
    grid = min(valid.shape) > 1
    return Facts(
        points=len(p),
        far_off=int(stray.sum()),
        shown=_only(cloud, kept),
        turned=turned,
        directions=seen,
        stations=len(places.pose),
        placed=placed,
        cells=float(valid.mean()) if grid else None,
        sigma=_by_distance(far[known], sigma[known]),
        median_sigma_m=float(np.median(sigma[known])) if known.any() else None,
        beyond_walls=_beyond(p, box),
        doubts=_doubts(cloud) if turned and grid and cloud.stations is None else (),
    )


def _sigmas(cloud: PointCloud, profile: np.ndarray, line: np.ndarray) -> np.ndarray:
    """One standard deviation of each point along its ray [n], m; 0 where it is not known."""
    random, systematic = (
        np.asarray(part, np.float64)[profile, line] for part in (cloud.sigma_random, cloud.sigma_systematic)
    )
    sigma = np.hypot(random, systematic)
    return np.where(np.isfinite(sigma) & (sigma < 1e3), sigma, 0.0)


def _is_within(p: np.ndarray, place: np.ndarray) -> bool:
    low, high = np.percentile(p, [1.0, 99.0], axis=0)
    return bool(((low < place) & (place < high)).all())


def _spacing_deg(cloud: PointCloud) -> float:
    """Usual angle between neighbouring profiles of one laser."""
    laser, angle = np.asarray(cloud.laser), np.asarray(cloud.angle, np.float64)
    steps = [np.diff(np.sort(angle[laser == one])) for one in np.unique(laser)]
    every = np.concatenate(steps)
    every = every[every > 0]
    return float(np.degrees(np.median(every))) if every.size else 0.0


def _by_distance(far: np.ndarray, sigma: np.ndarray) -> tuple[SigmaAt, ...]:
    bins = np.digitize(far, _BINS_M) - 1
    rows = []
    for number in np.unique(bins).tolist():
        mine = sigma[bins == number]
        median, most = np.percentile(mine, [50, 95])
        rows.append(SigmaAt(_BINS_M[number], _BINS_M[number + 1], len(mine), float(median), float(most)))
    return tuple(rows)


def _beyond(p: np.ndarray, box: RoomBox | None) -> int | None:
    if box is None or not box.sides:
        return None
    outside = np.zeros(len(p), bool)
    for side in box.sides.values():
        outside |= np.abs((p - box.centre_m) @ side.direction) > 0.5 * side.value_m + BEYOND_M
    return int(outside.sum())


def _doubts(cloud: PointCloud) -> tuple[str, ...]:
    record = np.asarray(cloud.record)
    if not len(record) or record.min() < 0:
        return ()
    # The cloud does not hold the records' numbers in the capture, so their positions in the sweep are given.
    return tuple(profile_doubts(cloud, np.arange(int(record.max()) + 1))) if record.max() < 10_000_000 else ()


def _only(cloud: PointCloud, kept: np.ndarray) -> PointCloud:
    import equinox as eqx

    xyz = np.where(kept[..., None], np.asarray(cloud.xyz), 0)
    return eqx.tree_at(lambda one: (one.xyz, one.valid), cloud, (xyz, kept))
