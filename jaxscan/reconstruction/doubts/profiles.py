"""Doubts about profiles: records whose points contradict those of the records around."""

import numpy as np

from jaxscan.reconstruction.cloud import PointCloud
from jaxscan.reconstruction.doubts.outliers import named, peaks, said, scatter


_FEW = 12
_COMMON = 0.1
"""Part of the lines that three neighbouring records must share [1]."""


def profile_doubts(cloud: PointCloud, numbers: np.ndarray) -> list[str]:
    """Records whose points lie far from those before and after, or are missing; distances do not depend on the angle.

    Args:
        cloud: The cloud.
        numbers: Of the records.
    """
    far: list[int] = []
    few: list[int] = []
    record, laser = np.asarray(cloud.record), np.asarray(cloud.laser)
    for one in np.unique(laser):
        own = np.flatnonzero(laser == one)
        # Of several candidates in a record, the first.
        own = own[np.unique(record[own], return_index=True)[1]]
        if len(own) < _FEW:
            continue
        valid = np.asarray(cloud.valid)[own]
        distance = np.hypot(*(np.asarray(cloud.xyz)[own, :, axis] for axis in (0, 1)))
        far += record[own[_far(distance, valid)]].tolist()
        few += record[own[_few(valid.mean(1))]].tolist()
    doubts = []
    if far:
        doubts.append(f"the points of {named(numbers[sorted(far)])} are not where those of the records around are")
    if few:
        doubts.append(f"{said(numbers[sorted(few)], 'has', 'have')} far fewer points than the records around")
    return doubts


def _far(distance: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Profiles that do not lie between those before and after, in logarithms of the distance from the axis."""
    log = np.log(np.maximum(distance, 1e-3))
    bends = np.zeros(len(log))
    for k in range(1, len(log) - 1):
        common = valid[k - 1] & valid[k] & valid[k + 1]
        if np.count_nonzero(common) >= max(8, _COMMON * valid.shape[1]):
            before, here, after = log[k - 1 : k + 2, common]
            # Beyond both neighbours: at the edge of a thing a profile is like one of them.
            outside = np.maximum(here - np.maximum(before, after), np.minimum(before, after) - here)
            bends[k] = abs(np.median(np.where(outside > 0, np.sign(here - before) * outside, 0.0)))
    return peaks(bends, max(6.0 * scatter(bends), 0.1))


def _few(share: np.ndarray) -> np.ndarray:
    least = np.minimum(share[:-2], share[2:])
    return 1 + np.flatnonzero((share[1:-1] < 0.25 * least) & (least > max(0.5 * np.median(share), 0.1)))
