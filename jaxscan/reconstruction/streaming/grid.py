"""The result of a reconstruction while it is being filled, on the host."""

import numpy as np

from jaxscan.geometry import Array
from jaxscan.reconstruction.cloud import PointCloud
from jaxscan.reconstruction.points import Points, grid_normals
from jaxscan.stripes import KEPT_FIELDS, FrameStripes, Stripes


class GrowingCloud:
    """Arrays of the full grid, allocated once: all the memory a sweep needs beyond its chunks."""

    def __init__(self, profiles: int, lines: int, *, travels: bool = False):
        """Args: the size of the grid, and whether profiles differ by metres of travel rather than by an angle."""
        grid = profiles, lines
        self.travels = travels
        self.fields: dict[str, np.ndarray] = {
            "xyz": np.zeros((*grid, 3), np.float32),
            "rgb": np.zeros((*grid, 3), np.uint8),
            "valid": np.zeros(grid, np.bool_),
        }
        for name in ("intensity", "sigma_random", "sigma_systematic"):
            self.fields[name] = np.zeros(grid, np.float32)
        self.centre = np.zeros((profiles, 3), np.float32)
        self.stripes = 0
        """Valid stripe centres so far, whether or not they gave a point."""

    def store(
        self,
        profiles: np.ndarray,
        points: Points,
        amplitude: Array,
        rgb: Array,
        found: Array,
        beside: dict[str, np.ndarray],
    ) -> None:
        """Copy one chunk.

        Args:
            profiles: Where they go.
            points: The points.
            amplitude: Amplitude of every stripe [DN].
            rgb: Colour of every stripe.
            found: Whether there was a stripe.
            beside: Fields of the cloud that smoothed points have.
        """
        rows = _rows(profiles)
        parts = {**points._asdict(), "rgb": rgb}
        parts["intensity"] = np.where(parts["valid"], np.asarray(amplitude), np.float32(0))
        parts["rgb"] = np.where(parts["valid"][:, :, None], parts["rgb"], np.uint8(0))
        for name in beside:
            self.fields.setdefault(name, np.zeros_like(self.fields["intensity"]))
        for name, field in self.fields.items():
            field[rows] = beside[name] if name in beside else parts[name]
        self.centre[rows] = parts["centre"]
        self.stripes += int(np.count_nonzero(found))

    def finish(
        self, record: np.ndarray, laser: np.ndarray, angle: np.ndarray, rank: np.ndarray, line_step: float | None
    ) -> PointCloud:
        """The cloud, with normals from its grid.

        Args:
            record: Record of each profile.
            laser: Laser of each profile.
            angle: The table's angle of each profile [rad], or the stage's position [m].
            rank: Number of each profile among those of the same record and laser.
            line_step: Angle between neighbouring lines [rad]; None for no normals.
        """
        xyz = self.fields["xyz"]
        normals = np.zeros_like(xyz) if line_step is None else self._normals(laser, angle, rank, line_step)
        return PointCloud(**self.fields, normals=normals, record=record, laser=laser, angle=angle, stations=None)

    def _normals(self, laser: np.ndarray, angle: np.ndarray, rank: np.ndarray, line_step: float) -> np.ndarray:
        """Neighbours are profiles of the same laser and rank, in the order of the angle."""
        parts = []
        for index, number in np.unique(np.stack([laser, rank], 1), axis=0):
            profiles = np.flatnonzero((laser == index) & (rank == number))
            profiles = profiles[np.argsort(angle[profiles], kind="stable")]
            whole = len(profiles) == len(laser) and bool(np.all(np.diff(profiles) == 1))
            rows = slice(None) if whole else profiles
            step = float(np.median(np.diff(angle[profiles]))) if len(profiles) > 1 else np.inf
            found = grid_normals(
                self.fields["xyz"][rows],
                self.fields["sigma_random"][rows],
                self.fields["valid"][rows],
                self.centre[rows],
                line_step=line_step,
                profile_step=step / self._usual_range() if self.travels else step,
            )
            if whole:
                return found
            parts.append((rows, found))
        normals = np.zeros_like(self.fields["xyz"])
        for rows, found in parts:
            normals[rows] = found
        return normals

    def _usual_range(self) -> float:
        """Median distance of the points from the camera [m]."""
        away = np.linalg.norm(self.fields["xyz"] - self.centre[:, None], axis=-1)[self.fields["valid"]]
        return float(np.median(away))


class GrowingStripes:
    """Stripes of a sweep while they are being filled."""

    def __init__(self, profiles: int, lines: int):
        self.fields: dict[str, np.ndarray] = {
            name: np.zeros((profiles, lines), {"saturated": np.uint8, "valid": np.bool_}.get(name, np.float32))
            for name in KEPT_FIELDS
        }
        self.fields["rgb"] = np.zeros((profiles, lines, 3), np.uint8)

    def store(self, profiles: np.ndarray, stripes: FrameStripes, rgb: Array) -> None:
        """Copy one chunk."""
        rows = _rows(profiles)
        found = {**stripes._asdict(), "rgb": rgb}
        for name, field in self.fields.items():
            field[rows] = np.asarray(found[name])

    def keep_clear(self, least: float) -> None:
        """Take out the stripes whose width is less than so many standard deviations of their centre."""
        if least > 0.0:
            width, sigma = self.fields["width"], self.fields["sigma"]
            _take_out(self.fields, width < np.float32(least) * np.maximum(sigma, np.float32(1e-4)))

    def finish(self, record: np.ndarray, laser: np.ndarray) -> Stripes:
        """The stripes; record and laser of each profile."""
        return Stripes(**self.fields, record=record, laser=laser)


def _take_out(fields: dict[str, np.ndarray], out: np.ndarray) -> None:
    for field in fields.values():
        field[out] = 0


def _rows(profiles: np.ndarray) -> slice | np.ndarray:
    consecutive = profiles[-1] - profiles[0] + 1 == len(profiles)
    return slice(profiles[0], profiles[-1] + 1) if consecutive else profiles
