"""The result of a reconstruction while it is being filled, on the host."""

import numpy as np

from jaxscan.geometry import Array
from jaxscan.reconstruction.cloud import PointCloud
from jaxscan.reconstruction.points.locate import Points
from jaxscan.reconstruction.points.normals import grid_normals
from jaxscan.stripes import FrameStripes, Stripes


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

    def store(self, profiles: np.ndarray, points: Points, amplitude: Array, rgb: Array, found: Array) -> None:
        """Copy one chunk, of which the first `len(profiles)` profiles are real.

        Args:
            profiles: Where they go.
            points: The points.
            amplitude: Amplitude of every stripe [DN].
            rgb: Colour of every stripe.
            found: Which stripes there were.
        """
        rows = _rows(profiles)
        count = len(profiles)
        valid = np.asarray(points.valid)[:count]
        self.xyz[rows] = np.asarray(points.xyz)[:count]
        self.sigma_random[rows] = np.asarray(points.sigma_random)[:count]
        self.sigma_systematic[rows] = np.asarray(points.sigma_systematic)[:count]
        self.valid[rows] = valid
        self.centre[rows] = np.asarray(points.centre)[:count]
        self.intensity[rows] = np.where(valid, np.asarray(amplitude)[:count], np.float32(0))
        self.rgb[rows] = np.where(valid[:, :, None], np.asarray(rgb)[:count], np.uint8(0))
        self.stripes += int(np.count_nonzero(np.asarray(found)[:count]))

    def finish(
        self, record: np.ndarray, laser: np.ndarray, angle: np.ndarray, rank: np.ndarray, line_step: float | None
    ) -> PointCloud:
        """The cloud, with normals from its grid.

        Args:
            record: Record of each profile.
            laser: Laser of each profile.
            angle: The table's angle of each profile [rad].
            rank: Number of each profile among those of the same record and laser.
            line_step: Angle between neighbouring lines [rad]; None for no normals.
        """
        return PointCloud(
            xyz=self.xyz,
            rgb=self.rgb,
            intensity=self.intensity,
            normals=np.zeros_like(self.xyz) if line_step is None else self._normals(laser, angle, rank, line_step),
            sigma_random=self.sigma_random,
            sigma_systematic=self.sigma_systematic,
            valid=self.valid,
            record=record,
            laser=laser,
            angle=angle,
        )

    def _normals(self, laser: np.ndarray, angle: np.ndarray, rank: np.ndarray, line_step: float) -> np.ndarray:
        """Neighbours are profiles of the same laser and rank, in the order of the angle."""
        parts = []
        for index, number in np.unique(np.stack([laser, rank], 1), axis=0):
            profiles = np.flatnonzero((laser == index) & (rank == number))
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


class GrowingStripes:
    """Stripes of a sweep while they are being filled."""

    def __init__(self, profiles: int, lines: int):
        self.fields: dict[str, np.ndarray] = {
            name: np.zeros((profiles, lines), {"saturated": np.uint8, "valid": np.bool_}.get(name, np.float32))
            for name in FrameStripes._fields
            if name != "grey"
        }
        self.fields["rgb"] = np.zeros((profiles, lines, 3), np.uint8)

    def store(self, profiles: np.ndarray, stripes: FrameStripes, rgb: Array) -> None:
        """Copy one chunk, of which the first `len(profiles)` profiles are real."""
        rows = _rows(profiles)
        found = {**stripes._asdict(), "rgb": rgb}
        for name, field in self.fields.items():
            field[rows] = np.asarray(found[name])[: len(profiles)]

    def finish(self, record: np.ndarray, laser: np.ndarray) -> Stripes:
        """The stripes; record and laser of each profile."""
        return Stripes(**self.fields, record=record, laser=laser)


def _rows(profiles: np.ndarray) -> slice | np.ndarray:
    consecutive = profiles[-1] - profiles[0] + 1 == len(profiles)
    return slice(profiles[0], profiles[-1] + 1) if consecutive else profiles
