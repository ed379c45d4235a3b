"""First poses of stations: guesses that bring walls onto walls, aligned on flat patches and tested by all points."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxscan.errors import CalibrationError, GivenError
from jaxscan.geometry import Scanner, compose, exponential, lit_points, nearest_rotation, poses, rays, transform, turn
from jaxscan.leastsq import MEDIAN_TO_SIGMA
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


SAME_DIRECTION = np.cos(np.radians(8.0))
"""Normals this near belong to one direction."""
DIRECTIONS = 12
LEAST_FACING = 0.02
"""Smallest share of all patches that face one direction."""
ANGLES_AGREE = np.radians(6.0)
TILT = np.cos(np.radians(12.0))
"""Axes of two stations are at most this far from parallel."""
ROTATIONS = 12
DISTINCT_TURN = np.radians(6.0)
BIN_M = 0.04
SHIFTS = 6
"""Shifts along each direction that are tried."""
REACH_M = 30.0
"""Largest shift between two stations, along each direction."""


def guess_poses(one: View, other: View) -> np.ndarray:
    """T_one_other [n, 4, 4] that match directions and places of walls; none where walls leave a turn open."""
    poses = []
    for rotation in _rotations(one, other):
        turned = View(*(field @ rotation.T for field in other))
        axes = _axes(one, turned)
        if axes is None:
            continue
        shifts = [_shifts(one, turned, axis) for axis in axes]
        grid = np.stack(np.meshgrid(*shifts, indexing="ij"), -1).reshape(-1, 3)
        T = np.tile(np.eye(4), (len(grid), 1, 1))
        T[:, :3, :3] = rotation
        T[:, :3, 3] = np.linalg.solve(axes, grid.T).T
        poses.append(T)
    return np.concatenate(poses) if poses else np.zeros((0, 4, 4))


def directions(normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions [k, 3] in which many patches face, and the share of each [k], largest first."""
    left = np.ones(len(normals), bool)
    found: list[np.ndarray] = []
    shares: list[float] = []
    near = normals @ normals.T > SAME_DIRECTION
    while left.any() and len(found) < DIRECTIONS:
        best = int(np.argmax((near & left).sum(1)))
        members = near[best] & left
        if members.sum() < max(3, LEAST_FACING * len(normals)):
            break
        mean = normals[members].mean(0)
        found.append(mean / np.linalg.norm(mean))
        shares.append(float(members.mean()))
        left &= ~members
    return np.array(found).reshape(-1, 3), np.array(shares)


def _rotations(one: View, other: View) -> list[np.ndarray]:
    """Rotations that bring two directions of the other onto two of the one, best first."""
    (to, to_share), (of, of_share) = directions(one.normals), directions(other.normals)
    if len(to) < 2 or len(of) < 2:
        return []
    to_pairs, to_angle = _pairs(to)
    of_pairs, of_angle = _pairs(of)
    same = np.abs(to_angle[:, None] - of_angle[None]) < ANGLES_AGREE
    i, j = np.nonzero(same)
    rotation = _frames(to, to_pairs)[i] @ _frames(of, of_pairs)[j].swapaxes(1, 2)
    rotation = rotation[rotation[:, 2, 2] > TILT]
    agree = np.einsum("nij,kj,li->nlk", rotation, of, to) > SAME_DIRECTION
    votes = (np.minimum(to_share[:, None], of_share[None]) * agree).sum((1, 2))
    kept: list[np.ndarray] = []
    for k in np.argsort(-votes, kind="stable"):
        if len(kept) < ROTATIONS and all(turn_between(rotation[k], each) > DISTINCT_TURN for each in kept):
            kept.append(rotation[k])
    return kept


def _pairs(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ordered pairs of directions that are far from parallel [n, 2], and the angle of each [n], rad."""
    angle = np.arccos(np.clip(directions @ directions.T, -1, 1))
    pairs = np.argwhere((angle > np.radians(40)) & (angle < np.radians(140)))
    return pairs, angle[tuple(pairs.T)]


def _frames(directions: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """A frame [n, 3, 3] for each pair: both directions share its turn alike."""
    a, b = directions[pairs[:, 0]], directions[pairs[:, 1]]
    x, y = a + b, a - b
    x, y = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (x, y))
    return np.stack([x, y, np.cross(x, y)], -1)


def turn_between(a: np.ndarray, b: np.ndarray) -> float:
    """Angle of the turn from rotation `a` to `b` [rad]."""
    return float(np.arccos(np.clip((np.trace(a.T @ b) - 1) / 2, -1, 1)))


def _axes(one: View, turned: View) -> np.ndarray | None:
    """Three directions [3, 3] across which both see walls (one may be at right angles to two); None with fewer."""
    ours, share = directions(np.concatenate([one.normals, -one.normals]))
    theirs = np.abs(turned.normals @ ours.T) > SAME_DIRECTION
    share = np.minimum(share, theirs.mean(0))
    axes: list[np.ndarray] = []
    for k in np.argsort(-share, kind="stable"):
        trial = np.array([*axes, ours[k]])
        if share[k] > LEAST_FACING / 2 and np.linalg.svd(trial)[1][-1] > 0.4 and len(axes) < 3:
            axes.append(ours[k])
    if len(axes) < 2:
        return None
    if len(axes) == 2:
        across = np.cross(axes[0], axes[1])
        axes.append(across / np.linalg.norm(across))
    return np.array(axes)


def _shifts(one: View, turned: View, axis: np.ndarray) -> np.ndarray:
    """Shifts [k] of the other along `axis` that bring walls onto walls that face the same way [m]."""
    size = int(REACH_M / BIN_M)
    score = np.zeros(2 * size + 1)
    for sense in (1.0, -1.0):
        lines = []
        for view in (one, turned):
            facing = sense * view.normals @ axis > SAME_DIRECTION
            place = np.round(view.patches[facing] @ axis / BIN_M).astype(int)
            count = np.bincount(np.clip(place + size, 0, 2 * size), minlength=2 * size + 1).astype(float)
            count[[0, -1]] = 0
            # A wall that lies between two bins is in both; the root keeps one large wall from deciding alone.
            lines.append(np.sqrt(np.convolve(count, [0.5, 1.0, 0.5], "same")))
        score += np.correlate(lines[0], lines[1], "full")[size : 3 * size + 1]
    found: list[int] = []
    while len(found) < SHIFTS and score.max() > 0:
        best = int(score.argmax())
        found.append(best)
        score[max(0, best - 3) : best + 4] = 0
    return (np.array(found, float) - size) * BIN_M if found else np.zeros(1)


NEAR_M = (0.5, 0.35, 0.25, 0.25, 0.2, 0.2, 0.2, 0.2)
"""Patches whose middles are at most this far apart are compared, round after round."""
FACING = np.cos(np.radians(20.0))
FEW = 500
"""Patches of a station that are used while there are many guesses."""


class Aligned(NamedTuple):
    """A pose T_one_other [4, 4], and how well so many pairs of patches agree in it."""

    pose: np.ndarray
    matched: int
    scale_m: float
    """Robust standard deviation of their distances [m]."""
    weakest: float
    """Smallest share of the information that any direction of the shift has [1]; 1/3 where all have the same."""


def align(one: View, other: View, pose: np.ndarray, *, few: bool = False) -> Aligned:
    """Move `pose` (T_one_other) until the patches of both, or some of them, lie in each other's planes."""
    step = max(1, -(-len(other.patches) // FEW)) if few else 1
    p, n = other.patches[::step], other.normals[::step]
    pose = pose.copy()
    apart, normals = np.zeros(0), np.zeros((0, 3))
    for near in NEAR_M:
        at, facing = transform(pose, p), n @ pose[:3, :3].T
        index, close = _nearest(one, np.asarray(at), facing, near)
        if close.sum() < 12:
            return Aligned(pose, 0, np.inf, 0.0)
        at, mean = at[close], one.normals[index[close]] + facing[close]
        normals = mean / np.linalg.norm(mean, axis=1, keepdims=True)
        apart = np.sum(normals * (one.patches[index[close]] - at), 1)
        scale = max(MEDIAN_TO_SIGMA * float(np.median(np.abs(apart))), 1e-3)
        weight = 1 / (1 + (apart / (2 * scale)) ** 2) ** 2
        design = np.column_stack([normals, np.cross(at, normals)])
        equations = (design * weight[:, None]).T @ design
        # Directions that no observation holds stay where they are.
        equations += 1e-3 * np.trace(equations) / 6 * np.eye(6)
        pose = _moved(pose, np.linalg.solve(equations, (design * weight[:, None]).T @ apart))
    share = np.linalg.eigvalsh(normals.T @ normals / len(normals))[0]
    return Aligned(pose, len(apart), MEDIAN_TO_SIGMA * float(np.median(np.abs(apart))), float(share))


def _nearest(one: View, at: np.ndarray, facing: np.ndarray, near: float) -> tuple[np.ndarray, np.ndarray]:
    """For each patch the nearest of the station that faces the same way [m], and whether it is near."""
    p, q = at.astype(np.float32), one.patches.astype(np.float32)
    square = (p * p).sum(1)[:, None] + (q * q).sum(1)[None] - 2 * p @ q.T
    square += np.where(facing.astype(np.float32) @ one.normals.astype(np.float32).T > FACING, 0, 1e6)
    index = square.argmin(1)
    return index, square[np.arange(len(p)), index] < near**2


def _moved(pose: np.ndarray, step: np.ndarray) -> np.ndarray:
    """The pose after a small shift [m] and turn [rad] in the frame that stays."""
    moved = np.asarray(compose(exponential(np.append(np.zeros(3), step[3:])), pose))
    moved[:3, 3] += step[:3]
    return moved


SOME = 400
"""Cells of each station by which many guesses are sorted."""
ALIGNED = 24
"""Guesses that are aligned."""
DISTINCT_M, DISTINCT_RAD = 0.3, np.radians(6.0)
"""Poses this far apart are different places."""
LEAST_SHARE = 0.12
"""Least share of the cells of both stations that both see."""
MOST_DENIED = 0.12
"""Largest share of compared cells that one station fills and the other looked through: things that were moved."""
DENIED = 30
"""A pose is worse than another if at least this many more cells contradict it, and half as many again."""
COARSER = 3.0
"""A place is worse than another if its walls agree so much worse [1]."""
FINE_M = 0.002
HELD = 3.0
"""Least number of patches that hold a pose along its weakest direction."""
MARKS_M = 0.2
"""Landmarks of two stations agree within this, whatever the calibration [m]."""
_ASK = "leave targets standing that both see, or say where the second stood ([[station]] of --known)"
START_M, START_RAD = 0.5, np.radians(10.0)


class Station(NamedTuple):
    """All that is known of one station, in its own frame."""

    name: str
    view: View
    space: Space
    landmarks: Mapping[str, np.ndarray]


class Pair(NamedTuple):
    """Where one station is in the frame of another, T_one_other [4, 4]."""

    pose: np.ndarray
    share: float
    """Share of the cells that both see [1]."""


class _Place(NamedTuple):
    aligned: Aligned
    common: int
    """Cells that both fill."""
    denied: int
    """Cells that one fills and the other looked through."""


def place_pair(one: Station, other: Station, *, first: np.ndarray | None = None) -> Pair:
    """T_one_other, by a first pose that is good to half a metre and ten degrees, if there is one.

    Raises:
        CalibrationError: If the two see too little in common, or fit in several places.
        GivenError: If what they see contradicts the first pose.
    """
    names = sorted(set(one.landmarks) & set(other.landmarks))
    at, of = (np.array([marks[name] for name in names]).reshape(-1, 3) for marks in (one.landmarks, other.landmarks))
    by_marks = pose_of(at, of) if first is None else None
    if first is not None:
        return _near(one, other, first, or_else=_contradicted(other))
    if by_marks is not None:
        return _near(one, other, by_marks)
    guesses = guess_poses(one.view, other.view)
    if len(guesses) == 0:
        raise CalibrationError(f"{one.name}, {other.name}: found walls in fewer than two common directions; {_ASK}.")
    common, denied = _compare(one.space, other.space, guesses, SOME)
    best = np.argsort(2 * denied - common, kind="stable")[:ALIGNED]
    places = _places(one, other, guesses[best], few=True)
    if names:
        places = [place for place in places if _distance(place.aligned.pose, at, of) < MARKS_M]
    return _decide(one, other, places)


def _near(one: Station, other: Station, given: np.ndarray, *, or_else: CalibrationError | None = None) -> Pair:
    """A given pose, aligned on the walls where these hold it; `or_else` is raised if they contradict it."""
    places = _places(one, other, given[None])
    for place in places:
        if not is_far(place.aligned.pose, given):
            if or_else is not None and place.denied > max(DENIED, MOST_DENIED * (place.common + place.denied)):
                raise or_else
            return Pair(place.aligned.pose, place.common / _cells(one, other))
    # Walls that leave one direction open still correct the pose along the others.
    aligned = align(one.view, other.view, given).pose
    (common, _), (_, denied) = _compare(one.space, other.space, np.array([given, aligned]))
    if or_else is not None and (places or common == 0 or denied > max(DENIED, common / 2)):
        raise or_else
    return Pair(given, common / _cells(one, other))


def _contradicted(station: Station) -> GivenError:
    return GivenError(
        f"{station.name}: its given place ([[station]] of --known) is contradicted by what the stations see; expected "
        f"it within {START_M:g} m and {np.degrees(START_RAD):.0f} degrees, in metres and degrees from the first "
        "station's place: correct it, or leave it out."
    )


def _places(one: Station, other: Station, guesses: np.ndarray, *, few: bool = False) -> list[_Place]:
    """The guesses that walls hold, aligned and compared; those that see most in common first."""
    aligned = [align(one.view, other.view, guess, few=few) for guess in guesses]
    aligned = [each for each in aligned if each.weakest * each.matched >= HELD]
    if not aligned:
        return []
    counts = _compare(one.space, other.space, np.array([each.pose for each in aligned]))
    places = [_Place(each, int(c), int(d)) for each, c, d in zip(aligned, *counts, strict=True)]
    return sorted(places, key=lambda place: 2 * place.denied - place.common)


def _compare(one: Space, other: Space, poses: np.ndarray, some: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """For poses T_one_other [n, 4, 4]: cells that both fill, and that one fills and the other looked through [n]."""
    common, denied = np.zeros(len(poses), int), np.zeros(len(poses), int)
    for space, seen, moved in ((one, other, poses), (other, one, np.linalg.inv(poses))):
        points = seen.some[:: max(1, len(seen.some) // some) if some else 1]
        for k, T in enumerate(moved):
            state = space.at(np.asarray(transform(T, points)))
            common[k] += np.count_nonzero(state == FILLED)
            denied[k] += np.count_nonzero(state == FREE)
    return common, denied


def _decide(one: Station, other: Station, places: list[_Place]) -> Pair:
    """The place that explains most; refused where it explains too little, or another place is as good."""
    names = f"{one.name}, {other.name}"
    places = [place for place in places if place.common >= LEAST_SHARE * _cells(one, other)]
    places = [place for place in places if place.denied <= MOST_DENIED * (place.common + place.denied)]
    if not places:
        raise CalibrationError(
            f"{names}: found no place in which they see {100 * LEAST_SHARE:.0f} % of their points in common and look "
            f"through nothing that the other sees; take a sweep between the two, {_ASK}."
        )
    most = max(place.common for place in places)
    places = [place for place in places if place.common >= most / 2]
    least = min(place.denied for place in places)
    places = [place for place in places if place.denied < 1.5 * least + DENIED]
    finest = max(min(place.aligned.scale_m for place in places), FINE_M)
    places = [place for place in places if place.aligned.scale_m <= COARSER * finest]
    best = max(places, key=lambda place: place.common)
    for rival in places:
        if _far(rival.aligned.pose, best.aligned.pose, DISTINCT_M, DISTINCT_RAD):
            turn = np.degrees(turn_between(rival.aligned.pose[:3, :3], best.aligned.pose[:3, :3]))
            raise CalibrationError(
                f"{names}: found two places of the second that fit the room alike, {turn:.0f} degrees apart; {_ASK}."
            )
    aligned = align(one.view, other.view, best.aligned.pose)
    return Pair(aligned.pose, best.common / _cells(one, other))


def _cells(one: Station, other: Station) -> int:
    return len(one.space.some) + len(other.space.some)


def is_far(pose: np.ndarray, given: np.ndarray) -> bool:
    """Whether a pose is farther from a given one than the tolerance of those."""
    return _far(pose, given, START_M, START_RAD)


def _far(a: np.ndarray, b: np.ndarray, metres: float, radians: float) -> bool:
    """Whether two poses are different places."""
    return bool(np.linalg.norm(a[:3, 3] - b[:3, 3]) > metres or turn_between(a[:3, :3], b[:3, :3]) > radians)


def _distance(pose: np.ndarray, at: np.ndarray, of: np.ndarray) -> float:
    """Median distance of landmarks [n, 3] of one station from those of the other [m]."""
    return float(np.median(np.linalg.norm(transform(pose, of) - at, axis=1)))


def place_stations(
    sweeps: Sequence[SweepStripes],
    scanner: Scanner,
    *,
    tracks: Tracks | None = None,
    start: Mapping[int, np.ndarray] | None = None,
) -> np.ndarray:
    """First poses of the stations, good to a few centimetres and a degree; an adjustment makes them exact.

    Two stations are placed by their walls: guesses that bring walls onto walls are aligned on flat patches, and judged
    by all points: where one station looked through, the other must see nothing. A box room fits itself in two ways or
    more; furniture decides, or landmarks, or a first pose. More stations form a tree, best pairs first.

    Args:
        sweeps: Sweeps with the numbers of their stations, 0 to S - 1.
        scanner: The stored scanner.
        tracks: Targets by name that several stations see; features without names are not used.
        start: A first pose T_room_scanner for some of the stations, good to half a metre and ten degrees.

    Returns:
        T_room_scanner [S, 4, 4]; the identity for station 0.

    Raises:
        CalibrationError: If a station sees too little of the surfaces that others see, or fits in several places.
    """
    numbers = sorted({sweep.station for sweep in sweeps})
    if numbers != list(range(len(numbers))):
        raise CalibrationError(f"stations: found the numbers {numbers}, expected 0 to {len(numbers) - 1}.")
    poses = np.tile(np.eye(4), (len(numbers), 1, 1))
    if len(numbers) < 2:
        return poses
    known = {0: np.eye(4), **(start or {})}
    stations = [_station(number, sweeps, scanner, tracks) for number in numbers]
    tried: dict[tuple[int, int], Pair | CalibrationError] = {}
    for a in numbers:
        for b in numbers[a + 1 :]:
            first = np.linalg.inv(known[a]) @ known[b] if a in known and b in known and start else None
            try:
                tried[a, b] = place_pair(stations[a], stations[b], first=first)
            except CalibrationError as problem:
                tried[a, b] = problem
    for old, new, pose in _tree(tried, len(numbers)):
        poses[new] = poses[old] @ pose
    return poses


def _tree(tried: Mapping[tuple[int, int], Pair | CalibrationError], count: int) -> list[tuple[int, int, np.ndarray]]:
    """The way to every station from station 0, over the pairs that see most in common: steps (old, new, T_old_new)."""
    pairs = {key: pair for key, pair in tried.items() if isinstance(pair, Pair)}
    reached, steps = {0}, []
    while len(reached) < count:
        ways = {key: pair for key, pair in pairs.items() if (key[0] in reached) != (key[1] in reached)}
        if not ways:
            problems = [p for key, p in tried.items() if (key[0] in reached) != (key[1] in reached)]
            raise next(p for p in problems if isinstance(p, CalibrationError))
        (a, b), pair = max(ways.items(), key=lambda item: item[1].share)
        steps.append((a, b, pair.pose) if a in reached else (b, a, np.linalg.inv(pair.pose)))
        reached.add(steps[-1][1])
    return steps


def _station(number: int, sweeps: Sequence[SweepStripes], scanner: Scanner, tracks: Tracks | None) -> Station:
    mine = [k for k, sweep in enumerate(sweeps) if sweep.station == number]
    view = look_around([sweeps[k] for k in mine], scanner)
    marks = {} if tracks is None else find_landmarks(tracks, {k: sweeps[k] for k in mine}, scanner, view)
    return Station(sweeps[mine[0]].name, view, see_space(view), marks)
