"""Normals of clouds on a grid that have none, so that they know their sides as others do."""

import numpy as np
from jaxtyping import Float

from jaxscan.reconstruction import PointCloud, grid_normals


_LEAST = 3
"""Profiles and lines of a grid."""
_UNEVEN = 2.0
"""How much larger steps between neighbouring rays of a scanner may be than others: a camera's are closer together at
its edges. From a place where no scanner stood they differ far more."""
_FEWEST, _MOST_PROFILES = 100, 200
_MOST_STEP_RAD = 0.1


def gridded_normals(cloud: PointCloud, places: Float[np.ndarray, "profiles 3"]) -> np.ndarray | None:
    """Unit normals towards the scanner, float32 [profiles, lines, 3]; zero where there is none.

    Args:
        cloud: Of any scanner.
        places: Where the scanner stood at each profile, m.

    Returns:
        None if the cloud has no grid, or none that is even as seen from those places.
    """
    valid = np.asarray(cloud.valid)
    if min(valid.shape) < _LEAST:
        return None
    # Places on a map have more digits than normals are counted with.
    xyz = np.where(valid[:, :, None], np.asarray(cloud.xyz) - places[0], 0.0).astype(np.float32)
    centre = (places - places[0]).astype(np.float32)
    line_step, profile_step = (_step(xyz - centre[:, None], valid, axis) for axis in (1, 0))
    if line_step is None or profile_step is None:
        return None
    sigma = np.asarray(cloud.sigma_random, np.float32)
    return grid_normals(xyz, sigma, valid, centre, line_step=line_step, profile_step=profile_step)


def _step(rays: np.ndarray, valid: np.ndarray, axis: int) -> float | None:
    """The usual angle between neighbouring rays along an axis of the grid [rad]; None if they are not even."""
    few = max(1, valid.shape[1 - axis] // _MOST_PROFILES)
    part = (slice(None, None, few), slice(None)) if axis == 1 else (slice(None), slice(None, None, few))
    rays, valid = rays[part], valid[part]
    ahead, behind = (np.take(rays, np.arange(1, rays.shape[axis]) - k, axis) for k in (0, 1))
    both = np.take(valid, np.arange(1, valid.shape[axis]), axis) & np.take(
        valid, np.arange(valid.shape[axis] - 1), axis
    )
    a, b = ahead[both].astype(np.float64), behind[both].astype(np.float64)
    if len(a) < _FEWEST:
        return None
    angles = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ni,ni->n", a, b))
    low, usual, high = np.percentile(angles, [10, 50, 90])
    return float(usual) if 0 < usual < _MOST_STEP_RAD and high <= _UNEVEN * low else None
