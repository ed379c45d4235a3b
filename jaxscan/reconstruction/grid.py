"""The result of a reconstruction while it is being filled, on the host."""

import numpy as np

from jaxscan.reconstruction.cloud import PointCloud
from jaxscan.reconstruction.normals import grid_normals
from jaxscan.reconstruction.points import Points


class GrowingCloud:
    """Arrays of the full grid, allocated once: all the memory a sweep needs beyond its chunks."""

    def __init__(self, profiles: int, lines: int):
        self.xyz = np.zeros((profiles, lines, 3), np.float32)
        self.rgb = np.zeros((profiles, lines, 3), np.uint8)
        self.intensity = np.zeros((profiles, lines), np.float32)
        self.sigma_random = np.zeros((profiles, lines), np.float32)
        self.sigma_systematic = np.zeros((profiles, lines), np.float32)
        self.valid = np.zeros((profiles, lines), np.bool_)
        self.centre = np.zeros((profiles, 3), np.float32)
        self.stripes = 0
        """Valid stripe centres so far, whether or not they gave a point."""

    def store(self, records: np.ndarray, points: Points) -> None:
        """Copy the points of one chunk, of which the first `len(records)` profiles are real."""
        count = len(records)
        consecutive = records[-1] - records[0] + 1 == count
        rows = slice(records[0], records[-1] + 1) if consecutive else records
        self.xyz[rows] = np.asarray(points.xyz)[:count]
        self.rgb[rows] = np.asarray(points.rgb)[:count]
        self.intensity[rows] = np.asarray(points.intensity)[:count]
        self.sigma_random[rows] = np.asarray(points.sigma_random)[:count]
        self.sigma_systematic[rows] = np.asarray(points.sigma_systematic)[:count]
        self.valid[rows] = np.asarray(points.valid)[:count]
        self.centre[rows] = np.asarray(points.centre)[:count]
        self.stripes += int(np.asarray(points.stripes)[:count].sum())

    def finish(self, laser: np.ndarray, angle: np.ndarray, line_step: float | None) -> PointCloud:
        """The cloud, with normals from its grid.

        Args:
            laser: Laser of each profile.
            angle: The table's angle of each profile [rad].
            line_step: Angle between neighbouring lines [rad]; None for no normals.
        """
        return PointCloud(
            xyz=self.xyz,
            rgb=self.rgb,
            intensity=self.intensity,
            normals=np.zeros_like(self.xyz) if line_step is None else self._normals(laser, angle, line_step),
            sigma_random=self.sigma_random,
            sigma_systematic=self.sigma_systematic,
            valid=self.valid,
            record=np.arange(len(laser), dtype=np.int32),
            laser=laser,
            angle=angle,
        )

    def _normals(self, laser: np.ndarray, angle: np.ndarray, line_step: float) -> np.ndarray:
        """Neighbours are profiles of the same laser, in the order of the angle."""
        parts = []
        for index in np.unique(laser):
            profiles = np.flatnonzero(laser == index)
            profiles = profiles[np.argsort(angle[profiles], kind="stable")]
            whole = len(profiles) == len(laser) and bool(np.all(np.diff(profiles) == 1))
            rows = slice(None) if whole else profiles
            found = grid_normals(
                self.xyz[rows],
                self.sigma_random[rows],
                self.valid[rows],
                self.centre[rows],
                line_step=line_step,
                profile_step=float(np.median(np.diff(angle[profiles]))) if len(profiles) > 1 else np.inf,
            )
            if whole:
                return found
            parts.append((rows, found))
        normals = np.zeros(self.xyz.shape, np.float32)
        for rows, found in parts:
            normals[rows] = found
        return normals
