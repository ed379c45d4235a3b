"""The room as one station sees it: points, from where they were seen, and flat patches."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxscan.errors import CalibrationError
from jaxscan.geometry import Scanner, lit_points, poses, stripe_pixel, transform
from jaxscan.recalibration.observed import SweepStripes


PROFILES, LINES = 360, 128
"""Profiles and lines of each laser that are used at most."""
PATCH_RAD = 0.09
"""Width of a patch [rad]: enough for a good normal, few corners inside."""
PATCH_LINES = 8
FLAT_M, FLAT_SHARE = 0.006, 0.004
"""Largest scatter of a flat patch [m], and as a share of its distance."""
FARTHEST_M = 100.0


class View(NamedTuple):
    """Some points of a station in its scanner frame [m]."""

    points: np.ndarray
    """[n, 3]."""
    eyes: np.ndarray
    """Where the camera was when it saw each point [n, 3]."""
    patches: np.ndarray
    """Middle of each flat patch [m, 3]."""
    normals: np.ndarray
    """Unit normals of the patches, towards the camera [m, 3]."""


def look_around(sweeps: Sequence[SweepStripes], scanner: Scanner) -> View:
    """The view of a station from all its sweeps.

    Args:
        sweeps: Sweeps from one place.
        scanner: Its covariance is not used.

    Raises:
        CalibrationError: If there are too few flat patches to find walls in.
    """
    parts = [
        _look(sweep, scanner, np.flatnonzero(sweep.laser == laser)) for sweep in sweeps for laser in set(sweep.laser)
    ]
    view = View(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))
    if len(view.patches) < 30:
        raise CalibrationError(
            f"{sweeps[0].name}: found {len(view.patches)} flat patches, too few to find walls in; "
            "expected a sweep of a room, a quarter of a turn or more."
        )
    return view


def _look(sweep: SweepStripes, scanner: Scanner, profiles: np.ndarray) -> View:
    """The view of one laser of one sweep."""
    profiles = profiles[:: max(1, -(-len(profiles) // PROFILES))]
    lines = np.arange(0, sweep.centre.shape[1], max(1, -(-sweep.centre.shape[1] // LINES)))
    grid = np.ix_(profiles, lines)
    valid = sweep.valid[grid].copy()
    row, column = np.nonzero(valid)
    q = np.asarray(
        stripe_pixel(
            sweep.centre[grid][row, column].astype(np.float64), lines[column].astype(np.float64), sweep.stripe_axis
        )
    )
    phi = sweep.angle[sweep.record[profiles]].astype(np.float64)
    pose = np.asarray(poses(scanner.rig, phi[row]))
    p_cam, incidence = lit_points(scanner.rig, q, sweep.laser[profiles][row])
    xyz, eyes, distance = np.asarray(transform(pose, p_cam)), pose[:, :3, 3], np.linalg.norm(p_cam, axis=1)
    exists = (incidence > 0) & (distance > 0) & (distance < FARTHEST_M)
    valid[row, column] = exists
    on_grid, eyes_on_grid = np.zeros((*valid.shape, 3)), np.zeros((*valid.shape, 3))
    on_grid[row, column], eyes_on_grid[row, column] = xyz, eyes
    spacing = float(np.median(np.abs(np.diff(phi)))) if len(phi) > 1 else PATCH_RAD
    width = int(np.clip(round(PATCH_RAD / max(spacing, 1e-6)), 2, 16))
    return View(on_grid[valid], eyes_on_grid[valid], *_patches(on_grid, eyes_on_grid, valid, width))


def _patches(points: np.ndarray, eyes: np.ndarray, valid: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Middles and normals [m, 3] of the blocks of `width` profiles that are flat."""
    profiles, lines = (size - size % step for size, step in zip(valid.shape, (width, PATCH_LINES), strict=True))

    def blocks(field: np.ndarray) -> np.ndarray:
        rest = field.shape[2:]
        cut = field[:profiles, :lines].reshape(profiles // width, width, lines // PATCH_LINES, PATCH_LINES, *rest)
        return cut.swapaxes(1, 2).reshape(-1, width * PATCH_LINES, *rest)

    seen = blocks(valid)
    count = seen.sum(1)
    full = count >= max(6, 0.6 * width * PATCH_LINES)
    seen, count = seen[full], count[full][:, None]
    p, weight = blocks(points)[full], seen[..., None].astype(np.float64)
    middle = (p * weight).sum(1) / count
    eye = (blocks(eyes)[full] * weight).sum(1) / count
    apart = (p - middle[:, None]) * weight
    values, vectors = np.linalg.eigh(apart.swapaxes(1, 2) @ apart / count[..., None])
    scatter = np.sqrt(np.maximum(values, 0))
    distance = np.linalg.norm(middle - eye, axis=1)
    flat = scatter[:, 0] < FLAT_M + FLAT_SHARE * distance
    flat &= scatter[:, 1] > 4 * scatter[:, 0]
    normal = vectors[:, :, 0]
    normal = normal * np.sign(np.sum(normal * (eye - middle), 1, keepdims=True))
    return middle[flat], normal[flat]
