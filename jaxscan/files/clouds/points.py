"""From the organised cloud to lists of points, as file formats hold them, and back."""

from collections.abc import Iterator

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.reconstruction import CloudPoints as Points
from jaxscan.reconstruction import PointCloud


BLOCK_POINTS = 1 << 20
"""Grid cells worked on at a time: enough to be fast, little enough for any memory."""


def blocks(cloud: PointCloud) -> Iterator[Points]:
    """The valid points, some profiles at a time; blocks without points are left out."""
    profiles, lines = cloud.valid.shape
    stride = max(1, BLOCK_POINTS // max(1, lines))
    for start in range(0, profiles, stride):
        points = cloud.points(start, start + stride)
        if len(points.xyz):
            yield points


def all_points(cloud: PointCloud) -> Points:
    """The valid points of the whole cloud."""
    return cloud.points()


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
