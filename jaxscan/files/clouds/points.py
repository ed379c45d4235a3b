"""From the organised cloud to lists of points, as file formats hold them, and back."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.reconstruction.cloud import PointCloud


BLOCK_POINTS = 1 << 20
"""Grid cells worked on at a time: enough to be fast, little enough for any memory."""


class Points(NamedTuple):
    """The valid points of a cloud, in the order of the grid."""

    xyz: np.ndarray
    """Position [m], float32 [n, 3], scanner frame."""
    normals: np.ndarray
    """float32 [n, 3]; zero where there is none."""
    rgb: np.ndarray
    """uint8 [n, 3]."""
    intensity: np.ndarray
    """Amplitude [DN], float32 [n]."""
    sigma: np.ndarray
    """Both uncertainties together [m], float32 [n]."""
    sigma_random: np.ndarray
    sigma_systematic: np.ndarray
    step: np.ndarray
    """Profile, int32 [n]."""
    row: np.ndarray
    """Line, int32 [n]."""
    laser: np.ndarray
    """uint8 [n]."""


def blocks(cloud: PointCloud) -> Iterator[Points]:
    """The valid points, some profiles at a time; blocks without points are left out."""
    profiles, lines = cloud.valid.shape
    stride = max(1, BLOCK_POINTS // max(1, lines))
    for start in range(0, profiles, stride):
        part = slice(start, start + stride)
        step, row = np.nonzero(np.asarray(cloud.valid[part]))
        if len(step) == 0:
            continue

        def take(field, dtype, part=part, step=step, row=row):
            return np.asarray(field[part])[step, row].astype(dtype)

        random, systematic = take(cloud.sigma_random, np.float32), take(cloud.sigma_systematic, np.float32)
        yield Points(
            xyz=take(cloud.xyz, np.float32),
            normals=take(cloud.normals, np.float32),
            rgb=take(cloud.rgb, np.uint8),
            intensity=take(cloud.intensity, np.float32),
            sigma=np.hypot(random, systematic),
            sigma_random=random,
            sigma_systematic=systematic,
            step=(step + start).astype(np.int32),
            row=row.astype(np.int32),
            laser=np.asarray(cloud.laser[part])[step].astype(np.uint8),
        )


def all_points(cloud: PointCloud) -> Points:
    """The valid points of the whole cloud."""
    return Points(*(np.concatenate(fields) for fields in zip(*blocks(cloud), strict=True)))


def check_cloud(cloud: PointCloud, name: str) -> None:
    """See that a cloud can be written.

    Raises:
        CloudError: If it has no point, or one that is not finite, or too many lasers.
    """
    valid = np.asarray(cloud.valid)
    if not valid.any():
        raise CloudError(f"{name}: the cloud has no valid point, so there is nothing to write.")
    if np.max(cloud.laser) > 255 or np.min(cloud.laser) < 0:
        raise CloudError(f"{name}: found laser {np.max(cloud.laser)}, expected 0 to 255.")
    for field in ("xyz", "normals", "intensity", "sigma_random", "sigma_systematic"):
        values = np.asarray(getattr(cloud, field))
        # One pass without a copy; where it fails, see whether a valid point is meant.
        with np.errstate(invalid="ignore"):
            finite = np.isfinite(values.sum(dtype=np.float64))
        if not finite and not np.isfinite(values[valid]).all():
            raise CloudError(f"{name}: {field} of a valid point is not finite.")
