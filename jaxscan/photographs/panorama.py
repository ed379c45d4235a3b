"""All photographs as one picture round the axis of the scanner."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from jaxscan.errors import CalibrationError
from jaxscan.geometry import Scanner
from jaxscan.photographs.colour import BlendSettings, colour_points, fill_holes
from jaxscan.photographs.occluder import REFERENCES, Occluder, make_occluder
from jaxscan.photographs.photograph import Lens, Photographs, border_rays, poses
from jaxscan.photographs.surface import surface_samples
from jaxscan.reconstruction import PointCloud


Projection = Literal["equirectangular", "cylinder"]
STEEPEST_CYLINDER = np.radians(75.0)
NARROW = np.radians(8.0)
"""Standard deviation of the weight over the angle between a photograph's middle and a place of the picture [rad], if
depths are known."""
LEAST_FACING = 0.2


@dataclass(frozen=True)
class PanoramaFrame:
    """The ray of each pixel of a panorama: the scanner's x axis is in the middle, and its z axis points up.

    Azimuth falls from left to right, as for someone who looks outward; a whole turn is as wide as the picture.
    """

    projection: Projection
    width: int
    height: int
    top: float
    """Elevation of the upper edge of the picture [rad], or its tangent for a cylinder."""

    @property
    def rows_above(self) -> int:
        """Rows of the whole sphere above the picture."""
        return round((np.pi / 2 - self.top) / self.per_pixel)

    @property
    def per_pixel(self) -> float:
        """Angle of a pixel on the horizon [rad]."""
        return 2 * np.pi / self.width

    def rays(self) -> Float[np.ndarray, "height width 3"]:
        """Unit ray of each pixel, scanner frame, float32."""
        azimuth = np.pi - (np.arange(self.width) + 0.5) * self.per_pixel
        level = self.top - (np.arange(self.height) + 0.5) * self.per_pixel
        elevation = (level if self.projection == "equirectangular" else np.arctan(level))[:, None]
        flat = np.cos(elevation)
        up = np.broadcast_to(np.sin(elevation), (self.height, self.width))
        return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), up], -1).astype(np.float32)

    def pixels(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
        """Pixel (u, v) of points in the scanner frame; (0, 0) is the centre of the top-left pixel."""
        x, y, z = np.moveaxis(np.asarray(points, np.float64), -1, 0)
        slope = z / np.maximum(np.hypot(x, y), 1e-12)
        level = np.arctan(slope) if self.projection == "equirectangular" else slope
        return np.stack([(np.pi - np.arctan2(y, x)) / self.per_pixel, (self.top - level) / self.per_pixel], -1) - 0.5


@dataclass(frozen=True)
class Panorama:
    """A picture round the axis, as seen from the scanner's origin."""

    frame: PanoramaFrame
    rgb: np.ndarray
    distance_m: np.ndarray | None = None
    """Distance from the scanner's origin [m], [height, width]; 0 where unknown. None without a cloud."""
    normals: np.ndarray | None = None
    """[height, width, 3], scanner frame; zero where unknown."""


def panorama_frame(
    scanner: Scanner, projection: Projection = "equirectangular", width: int | None = None
) -> PanoramaFrame:
    """The frame of all that a turning camera sees, by default at its own resolution.

    Raises:
        CalibrationError: If the camera does not turn.
    """
    if scanner.turntable.carries != "scanner":
        raise CalibrationError(
            "a panorama needs a camera that turns, and the camera of this calibration "
            f"does not (carries: {scanner.turntable.carries})."
        )
    if width is None:
        width = 2 * round(np.pi / float(Lens.of(scanner.camera).per_pixel))
    pose = poses(scanner, np.zeros(1))[0]
    elevation = np.arcsin(np.clip(border_rays(scanner.camera) @ pose[2, :3], -1, 1))
    low, high = float(elevation.min()), float(elevation.max())
    if projection == "cylinder":
        low, high = (float(np.tan(np.clip(end, -STEEPEST_CYLINDER, STEEPEST_CYLINDER))) for end in (low, high))
    step = 2 * np.pi / width
    # Rows of the whole sphere: programs place a part of it by whole rows.
    above = int(np.floor((np.pi / 2 - high) / step)) if projection == "equirectangular" else 0
    top = np.pi / 2 - above * step if projection == "equirectangular" else high
    return PanoramaFrame(projection, width, max(1, int(np.ceil((top - low) / step))), top)


def make_panorama(
    photographs: Photographs, frame: PanoramaFrame, cloud: PointCloud | None = None, *, distance_m: float = 2.5
) -> Panorama:
    """Blend photographs to one picture, as seen from the scanner's origin.

    The camera moves on a small circle. With an organised cloud of the same sweep, the distance of each pixel says where
    each photograph shows it; without one, everything is taken to be at one distance [m], only photographs that look
    almost straight at it are used, and edges of things at other distances are seen a little beside their place.
    Photographs are iterated a second time without a cloud, to equalise exposures.

    Raises:
        CloudError: If the cloud has no grid.
    """
    rays = frame.rays()
    if cloud is None:
        points = rays.reshape(-1, 3) * np.float32(distance_m)
        nothing = np.zeros_like(points)
        step = _usual_step(photographs)
        few = np.linspace(0, len(points) - 1, REFERENCES).astype(int)
        usual, _ = colour_points(photographs, points[few], nothing[few], settings=_mean(np.inf))
        space = Occluder.of_nothing(points[few], usual)
        rgb, seen = colour_points(photographs, points, nothing, occluder=space, settings=_mean(step))
        return Panorama(frame, fill_holes(rgb.reshape(rays.shape), seen.reshape(rays.shape[:2])))
    distance, normals = draw_distances(frame, cloud, photographs.scanner)
    known = distance > 0
    inverse = np.where(known, 1 / np.maximum(distance, 1e-6), 0)[..., None]
    filled = 1 / np.maximum(fill_holes(inverse, known)[..., 0], 1e-3)
    points = (rays * filled[..., None]).astype(np.float32)
    # Surfaces seen at a slant are as sharp here as in their photographs.
    cosine = -np.sum(normals * rays, -1, keepdims=True)
    facing = np.where(known[..., None], normals - rays * np.maximum(LEAST_FACING - cosine, 0), 0).astype(np.float32)
    occluder = make_occluder(cloud, photographs.scanner)
    narrow = BlendSettings(bearing=NARROW)
    rgb, seen = colour_points(
        photographs, points.reshape(-1, 3), facing.reshape(-1, 3), occluder=occluder, settings=narrow
    )
    picture = fill_holes(rgb.reshape(rays.shape), seen.reshape(known.shape))
    return Panorama(frame, picture, distance, normals)


def draw_distances(
    frame: PanoramaFrame, cloud: PointCloud, scanner: Scanner
) -> tuple[Float[np.ndarray, "height width"], Float[np.ndarray, "height width 3"]]:
    """Distance [m] and normal of the nearest surface on every ray of a panorama; 0 where there is none."""
    nearest = np.full(frame.height * frame.width, np.inf, np.float32)
    normals = np.zeros((frame.height * frame.width, 3), np.float32)
    for samples in surface_samples(cloud, scanner, 0.7 * frame.per_pixel):
        pixel = np.rint(frame.pixels(samples.xyz)).astype(int)
        column, row = pixel[:, 0] % frame.width, pixel[:, 1]
        away = np.linalg.norm(samples.xyz, axis=-1)
        at = np.clip(row, 0, frame.height - 1) * frame.width + column
        # The nearest one is written last.
        order = np.argsort(-away)
        order = order[((row >= 0) & (row < frame.height) & (away < nearest[at]))[order]]
        nearest[at[order]], normals[at[order]] = away[order], samples.normals[order]
    distance = np.where(np.isfinite(nearest), nearest, 0)
    shape = frame.height, frame.width
    return distance.reshape(shape).astype(np.float32), normals.reshape(*shape, 3)


def _mean(bearing: float) -> BlendSettings:
    """A plain mean: where parallax is not known, colours that disagree are mixed, to avoid visible seams."""
    return BlendSettings(tolerance_dn=256.0, bearing=bearing)


def _usual_step(photographs: Photographs) -> float:
    """Usual angle between photographs [rad]."""
    angles = np.unique([shot.angle for shot in photographs])
    return float(np.median(np.diff(angles))) if len(angles) > 1 else 0.1
