"""A cloud as its scanner saw it: by azimuth and elevation."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


SIDES_DEG = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 9.0, 10.0, 15.0)
"""Sides of cells: parts of 180 degrees."""
POINTS_A_CELL = 8
WHOLE_SPHERE_DEG2 = 41253.0
SMALLEST_HOLE = 4
"""Cells of the smallest hole that is named."""


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
    """Of a cell."""
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
        """Of the middle of each row [rows]."""
        return 90.0 - (np.arange(len(self.count)) + 0.5) * self.side_deg

    @property
    def azimuth_deg(self) -> np.ndarray:
        """Of the middle of each column [columns]."""
        return 180.0 - (np.arange(self.count.shape[1]) + 0.5) * self.side_deg

    @property
    def band(self) -> slice:
        """The rows between the highest and the lowest point, but for one point in two hundred at either end."""
        return slice(self._row(self.highest_deg), self._row(self.lowest_deg) + 1)

    def _row(self, elevation_deg: float) -> int:
        return min(max(int((90.0 - elevation_deg) / self.side_deg), 0), len(self.count) - 1)

    def share(self, *, of_band: bool) -> float:
        """Part of all directions, or of those of the band, that have points [1]."""
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
    """Points by direction.

    Args:
        xyz: Points as seen from their station [n, 3], m, z up.
        sigma_m: One standard deviation of each [n], m; 0 where it is not known.
        spacing_deg: Of neighbouring profiles, where it is known; cells are no smaller.
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
    # Points themselves, not places between two of them.
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
    columns = empty.shape[1]
    left = {(int(row), int(column)) for row, column in np.argwhere(empty)}
    regions = []
    while left:
        edge = [left.pop()]
        region = []
        while edge:
            row, column = edge.pop()
            region.append((row, column))
            for place in ((row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)):
                beside = place[0], place[1] % columns
                if beside in left:
                    left.remove(beside)
                    edge.append(beside)
        found = np.array(region)
        regions.append((found[:, 0], found[:, 1]))
    return regions
