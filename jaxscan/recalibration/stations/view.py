"""The room as one station sees it: points, from where they were seen, and flat patches."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxscan.errors import CalibrationError
from jaxscan.geometry import Scanner, lit_points, nearest_rotation, poses, rays, transform, turn
from jaxscan.recalibration.observed import SweepStripes, Tracks


PROFILES, LINES = 360, 128
"""Profiles and lines of each laser that are used at most."""
PATCH_RAD = 0.09
"""Width of a patch [rad]: enough for a good normal, few corners inside."""
PATCH_LINES = 8
FLAT_M, FLAT_SHARE = 0.006, 0.004
"""Largest scatter of a flat patch [m], and as a share of its distance."""
FARTHEST_M = 100.0


class View(NamedTuple):
    """Points [n, 3] of a station in its scanner frame, and middles and normals of its flat patches [m, 3], m."""

    points: np.ndarray
    eyes: np.ndarray
    """Where the camera was when it saw each point [n, 3]."""
    patches: np.ndarray
    normals: np.ndarray


def look_around(sweeps: Sequence[SweepStripes], scanner: Scanner) -> View:
    """The view of a station from all its sweeps.

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
    q = sweep.pixels(profiles[row], lines[column])
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


BESIDE_RAD = np.radians(6.0)
"""Farthest patch on whose plane a target is taken to be."""
AGREE_M = 0.1
"""A landmark that is this far off was moved, or is another of the same name [m]."""
SPREAD_M = 0.05
"""Least width of landmarks across their longest direction, so that they hold a pose [m]."""


def find_landmarks(
    tracks: Tracks, sweeps: Mapping[int, SweepStripes], scanner: Scanner, view: View
) -> dict[str, np.ndarray]:
    """Points [3], m, by name: where the rays to named targets meet the flat patch that is nearest to them."""
    found: dict[str, np.ndarray] = {}
    mine = np.isin(tracks.sweep, list(sweeps))
    for number in np.unique(tracks.track[mine]):
        if number >= len(tracks.name) or not tracks.name[number]:
            continue
        sightings = np.flatnonzero(mine & (tracks.track == number))
        phi = np.array([sweeps[tracks.sweep[k]].angle[tracks.record[k]] for k in sightings], np.float64)
        pose = np.asarray(poses(scanner.rig, phi))
        ways = np.asarray(turn(pose[:, :3, :3], rays(scanner.rig, tracks.q[sightings])))
        points = [
            p for eye, ray in zip(pose[:, :3, 3], ways, strict=True) if (p := _on_patch(view, eye, ray)) is not None
        ]
        if points:
            found[tracks.name[number]] = np.median(points, 0)
    return found


def _on_patch(view: View, eye: np.ndarray, ray: np.ndarray) -> np.ndarray | None:
    """Where a ray meets the plane of the patch nearest to it; None where no patch is near."""
    ways = view.patches - eye
    cosine = ways @ ray / np.linalg.norm(ways, axis=1)
    near = int(cosine.argmax())
    slope = float(view.normals[near] @ ray)
    if cosine[near] < np.cos(BESIDE_RAD) or abs(slope) < 0.05:
        return None
    point: np.ndarray = eye + float(view.normals[near] @ ways[near]) / slope * ray
    return point


def pose_of(at: np.ndarray, of: np.ndarray) -> np.ndarray | None:
    """T_one_other [4, 4] that brings landmarks `of` [n, 3] of the other onto `at` [n, 3]; None where they hold none.

    Landmarks that were moved are left out, as long as three agree. Source: Kabsch, Acta Cryst. A32 (1976) 922.
    """
    while len(at) >= 3:
        middle_at, middle_of = at.mean(0), of.mean(0)
        both = (at - middle_at).T @ (of - middle_of) / len(at)
        if np.sqrt(np.linalg.svd(both, compute_uv=False)[1]) < SPREAD_M:
            return None
        rotation = nearest_rotation(both)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, middle_at - rotation @ middle_of
        apart = np.linalg.norm(transform(pose, of) - at, axis=1)
        if apart.max() < AGREE_M:
            return pose
        keep = np.arange(len(at)) != apart.argmax()
        at, of = at[keep], of[keep]
    return None


CELL_M = 0.1
CELLS = 160
"""Cells along the longest side at most; a large hall has larger ones."""
MARGIN = 2
RAYS = 12_000
UNSEEN, FREE, FILLED, AROUND = 0, 1, 2, 3


class Space(NamedTuple):
    """Cells [m] around a station, in its scanner frame, from their lowest corner on."""

    state: np.ndarray
    """`UNSEEN`, `FREE`, `FILLED`, or `AROUND` filled ones; uint8 [x, y, z]."""
    low: np.ndarray
    cell: float
    some: np.ndarray
    """One point of each filled cell [n, 3]."""

    def at(self, points: np.ndarray) -> np.ndarray:
        """State of the cells of points [..., 3]."""
        index = np.floor((points - self.low) / self.cell).astype(np.int32)
        inside = ((index >= 0) & (index < self.state.shape)).all(-1)
        index = np.where(inside[..., None], index, 0)
        return np.where(inside, self.state[index[..., 0], index[..., 1], index[..., 2]], UNSEEN)


def see_space(view: View) -> Space:
    """The cells that a view fills and looks through: where two rays or more went, and no point is in or beside it."""
    # Imported here, so that nobody who does not recalibrate loads SciPy.
    from scipy.ndimage import binary_dilation  # type: ignore[import-untyped]

    low, high = np.percentile(view.points, [0.2, 99.8], axis=0)
    cell = max(CELL_M, float((high - low).max()) / CELLS)
    low = low - MARGIN * cell
    shape = np.ceil((high - low) / cell).astype(int) + MARGIN
    inside = ((view.points > low) & (view.points < low + shape * cell)).all(1)
    points, eyes = view.points[inside], view.eyes[inside]
    index = np.ravel_multi_index(tuple(((points - low) / cell).astype(int).T), shape)
    _, first = np.unique(index, return_index=True)
    filled = np.zeros(shape, bool)
    filled.flat[index] = True
    passed = _passed(points, eyes, low, cell, shape)
    state = np.where(passed >= 2, FREE, UNSEEN).astype(np.uint8)
    state[binary_dilation(filled, np.ones((3, 3, 3)))] = AROUND
    state[filled] = FILLED
    return Space(state, low, cell, points[first])


def _passed(points: np.ndarray, eyes: np.ndarray, low: np.ndarray, cell: float, shape: np.ndarray) -> np.ndarray:
    """How many rays went through each cell; the last tenth of a ray may graze its surface, and does not count."""
    step = max(1, -(-len(points) // RAYS))
    points, eyes = points[::step], eyes[::step]
    ways = points - eyes
    reach = np.linalg.norm(ways, axis=1)
    end = 0.9 * reach - 1.5 * cell
    passed = np.zeros(int(np.prod(shape)), np.int32)
    for far in np.arange(0.0, max(end.max(), 0.0), 0.7 * cell):
        going = end > far
        at = eyes[going] + ways[going] * (far / reach[going])[:, None]
        index = np.floor((at - low) / cell).astype(int)
        index = index[((index >= 0) & (index < shape)).all(1)]
        passed += np.bincount(np.ravel_multi_index(tuple(index.T), shape), minlength=len(passed)).astype(np.int32)
    return passed.reshape(shape)
