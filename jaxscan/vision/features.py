"""Features and targets in laser-off images: pieces of an image are found again in others, to hundredths of a pixel."""

import functools
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import cv2
import numpy as np

from jaxscan.geometry import AbstractBoard, AprilGrid, Charuco, Chessboard, known_dictionary, median_sigma
from jaxscan.recalibration.tracks import Cylinder, FeatureEyes, Followed, FoundTargets, Walk
from jaxscan.vision.boards import find_corners
from jaxscan.vision.frames import to_grey


HALF = 9
"""Half side of a piece [px]."""
MARGIN = 4
"""Pixels around a piece that interpolation and steps need."""
_STEPS = 6
_DONE_PX = 2e-3
_FARTHEST_PX = 2.0
_GAIN = (0.6, 1.6)
_BENT, _NOISE_DN = 0.05, 2.0
"""Gradient of the shift over a piece that is usual [1], and noise of an image, to weigh it."""


class Patches(NamedTuple):
    """Pieces of images around features."""

    level: np.ndarray
    """Grey levels less their mean [n, side, side]."""
    solver: np.ndarray
    """Weighted pseudo-inverse [n, 8, side * side]: grey levels to shift (x, y), gain, offset, and the gradient of the
    shift over the piece, which a wall seen obliquely has."""
    columns: np.ndarray
    """Changes of the grey levels by these eight [n, 8, side * side]."""
    spread: np.ndarray
    """Variance of x and of y [n, 2] for noise of one grey level in every pixel."""


class Matched(NamedTuple):
    """Where pieces are in another image."""

    x: np.ndarray
    """[n, 2], px."""
    sigma: np.ndarray
    """Standard deviation of a coordinate by the remaining differences [px]."""
    difference: np.ndarray
    """Remaining difference, over the piece's own contrast [1]."""
    valid: np.ndarray


class Unrolled(NamedTuple):
    """An image, sampled at places of the unrolled one."""

    level: np.ndarray
    across: np.ndarray
    """Second differences along the rows, and `down` along the columns: with these, linear interpolation is as good as
    cubic, which OpenCV shifts by up to 0.05 px."""
    down: np.ndarray
    cylinder: Cylinder

    @staticmethod
    def of(image: np.ndarray, cylinder: Cylinder) -> "Unrolled":
        """An image, uint8 [rows, columns]."""
        second = np.array([[1.0, -2.0, 1.0]], np.float32)
        across, down = cv2.filter2D(image, cv2.CV_32F, second), cv2.filter2D(image, cv2.CV_32F, second.T)
        return Unrolled(image.astype(np.float32), across, down, cylinder)

    def pieces(self, x: np.ndarray, reach: int) -> np.ndarray:
        """Pieces [n, 2 reach + 1, 2 reach + 1] around whole places [n, 2], `reach` from the border at least."""
        r = np.arange(-reach, reach + 1)
        if not len(x):
            return np.zeros((0, len(r), len(r)), np.float32)
        row, column = x[:, 1, None, None] + r[:, None], x[:, 0, None, None] + r
        side = len(r)
        u = self.cylinder.u[row, column].astype(np.float32).reshape(-1, side)
        v = self.cylinder.v[row, column].astype(np.float32).reshape(-1, side)
        level, across, down = (
            np.asarray(cv2.remap(part, u, v, cv2.INTER_LINEAR), np.float32)
            for part in (self.level, self.across, self.down)
        )
        a, b = u - np.floor(u), v - np.floor(v)
        out = level - 0.5 * (a * (1 - a) * across + b * (1 - b) * down)
        return out.reshape(-1, side, side)


def make_patches(image: Unrolled, x: np.ndarray) -> Patches:
    """The pieces around features at whole places [n, 2]."""
    wide = image.pieces(x, HALF + 1)
    level = wide[:, 1:-1, 1:-1]
    level = level - level.mean((1, 2), keepdims=True)
    gx, gy = (wide[:, 1:-1, 2:] - wide[:, 1:-1, :-2]) / 2, (wide[:, 2:, 1:-1] - wide[:, :-2, 1:-1]) / 2
    n, r = len(x), np.arange(-HALF, HALF + 1, dtype=np.float32)
    along, down = np.broadcast_to(r, gx.shape), np.broadcast_to(r[:, None], gx.shape)
    bent = [gx * along, gx * down, gy * along, gy * down]
    columns = np.stack([gx, gy, level, np.ones_like(level), *bent], 1).reshape(n, 8, (2 * HALF + 1) ** 2)
    weighted = columns * _window().ravel()
    normal = weighted @ columns.transpose(0, 2, 1)
    normal += 1e-6 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(8, dtype=np.float32)
    normal[:, range(4, 8), range(4, 8)] += (_NOISE_DN / _BENT) ** 2
    solver = np.linalg.solve(normal, weighted)
    return Patches(level, solver, columns, (solver[:, :2] ** 2).sum(2))


def take(patches: Patches, index: np.ndarray) -> Patches:
    """The pieces at `index`."""
    return Patches(*(field[index] for field in patches))


def joined(parts: list[Patches]) -> Patches:
    """All pieces."""
    return Patches(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))


def match(patches: Patches, image: Unrolled, guess: np.ndarray) -> Matched:
    """Find pieces near guessed places, by least squares with gain and offset of the light.

    The steps are those of inverse compositional alignment; the image is interpolated by cubic convolution.

    Source: Baker and Matthews, Lucas-Kanade 20 years on, IJCV 56 (2004), section 3.
    """
    reach = HALF + MARGIN
    rows, columns = image.cylinder.u.shape
    whole = np.rint(guess).astype(int)
    inside = (whole >= reach).all(1) & (whole[:, 0] < columns - reach) & (whole[:, 1] < rows - reach)
    whole = np.where(inside[:, None], whole, reach)
    pieces = image.pieces(whole, reach)
    shift = np.where(inside[:, None], guess - whole, 0.0)
    step, left = np.zeros((len(guess), 8), np.float32), pieces[:, :1, :1]
    for _ in range(_STEPS):
        shift = np.clip(shift, -_FARTHEST_PX, _FARTHEST_PX)
        left = (_interpolate(pieces, shift) - patches.level).reshape(len(guess), -1)
        step = (patches.solver @ left[..., None])[..., 0]
        shift = shift - step[:, :2]
        if np.abs(step[:, :2]).max(initial=0.0) < _DONE_PX:
            break
    n = len(guess)
    left = left - (step[:, None] @ patches.columns)[:, 0]
    weight = _window().ravel()
    error = np.sqrt((left**2 @ weight) / weight.sum())
    contrast = np.sqrt(((patches.level.reshape(n, -1)) ** 2 @ weight) / weight.sum())
    gain = 1.0 + step[:, 2]
    valid = inside & (np.abs(shift) < _FARTHEST_PX).all(1) & (np.abs(step[:, :2]).max(1) < 10 * _DONE_PX)
    valid &= (gain > _GAIN[0]) & (gain < _GAIN[1])
    # Half of the differences' variance is that of the piece itself, which all its sightings share.
    sigma = np.sqrt(0.5 * patches.spread.mean(1)) * error / np.maximum(gain, _GAIN[0])
    return Matched(whole + shift, sigma, error / np.maximum(contrast, 1e-6), valid)


def _interpolate(pieces: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Pieces moved by less than `MARGIN` - 1 pixels, and reduced by `MARGIN` on all sides."""
    whole = np.floor(shift).astype(int)
    weights = _cubic((shift - whole).astype(np.float32))
    side = 2 * HALF + 1
    taps = np.arange(-1, 3)
    n = np.arange(len(pieces))[:, None, None]
    offset = np.arange(side) + MARGIN
    columns = offset[None, None, :] + whole[:, 0, None, None]
    across = np.zeros((len(pieces), pieces.shape[1], side), np.float32)
    every = np.arange(pieces.shape[1])[None, :, None]
    for tap in range(4):
        across += weights[:, 0, tap, None, None] * pieces[n, every, columns + taps[tap]]
    rows = offset[None, :, None] + whole[:, 1, None, None]
    out = np.zeros((len(pieces), side, side), np.float32)
    all_columns = np.arange(side)[None, None, :]
    for tap in range(4):
        out += weights[:, 1, tap, None, None] * across[n, rows + taps[tap], all_columns]
    return out


def _cubic(t: np.ndarray) -> np.ndarray:
    """Weights of four neighbours [..., 4] at the fraction t. Source: Keys, IEEE Trans. ASSP 29 (1981)."""
    t2, t3 = t * t, t * t * t
    return np.stack(
        [-0.5 * t + t2 - 0.5 * t3, 1 - 2.5 * t2 + 1.5 * t3, 0.5 * t + 2 * t2 - 1.5 * t3, 0.5 * (t3 - t2)], -1
    )


def _window() -> np.ndarray:
    r = np.arange(-HALF, HALF + 1, dtype=np.float32)
    g = np.exp(-0.5 * (r / (0.6 * HALF)) ** 2)
    return np.outer(g, g)


# Corners of a texture that stand out of the noise, and whether a room has enough of them.


_BLOCK = 11
"""Side of the window over which gradients are summed [px]."""
_LARGEST_SIGMA = 0.12
"""A feature is followed if noise alone moves it by less than this [px]."""
_LEAST_NOISE = 0.4
"""Least noise of an image [DN]: rounding, and changes with the view."""
_FEWEST, _CELLS, _FEWEST_CELLS = 40, (4, 4), 5
"""Fewest features of an image, cells of a grid over it, and fewest of these cells that have some."""
_LEAST_TEXTURED_SIDE = 64
_SEARCHED_PIXELS = 900_000
"""Most pixels of an image in which features are looked for."""


class Corners(NamedTuple):
    """Places of features in an image, best first."""

    x: np.ndarray
    """Whole column and row [n, 2], px."""
    sigma: np.ndarray
    """Standard deviation of a coordinate by the image's noise alone [px]."""


def image_noise(image: np.ndarray) -> float:
    """Noise of an image [DN], from the Laplacian's median: texture fills less than half of it.

    Source: Immerkær, Fast noise variance estimation, Computer Vision and Image Understanding 64 (1996).
    """
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    laplacian = cv2.filter2D(image, cv2.CV_32F, kernel)[1:-1:3, 1:-1:3]
    return max(median_sigma(laplacian) / 6.0, _LEAST_NOISE)


def find_features(image: np.ndarray, sees: np.ndarray, taken: np.ndarray, apart: int, most: int) -> Corners:
    """The best features of an image that lie apart from one another.

    A large image is reduced before: features are large too, and those that are not are many.
    """
    factor = int(np.ceil(np.sqrt(image.size / _SEARCHED_PIXELS)))
    rows, columns = image.shape[0] // factor, image.shape[1] // factor
    cut = image[: rows * factor, : columns * factor]
    small = cut if factor == 1 else np.asarray(cv2.resize(cut, (columns, rows), interpolation=cv2.INTER_AREA), np.uint8)
    noise = image_noise(small)
    # cornerMinEigenVal divides the derivatives of a uint8 image by 255 * 4 * block; those of a ramp of one grey level
    # per pixel are 8 before that.
    unit = (255.0 * 4.0 * _BLOCK / 8.0) ** 2
    # The noise of the gradients must not count as texture.
    weakest = cv2.cornerMinEigenVal(small, _BLOCK, ksize=3) * unit - 12 / 64 * (_BLOCK * noise) ** 2
    around = np.ones((2 * (apart // factor) + 1,) * 2, np.uint8)
    near = np.zeros(small.shape, np.uint8)
    near[np.minimum(taken[:, 1] // factor, rows - 1), np.minimum(taken[:, 0] // factor, columns - 1)] = 1
    middle = factor // 2
    peak = (weakest > (noise / _LARGEST_SIGMA) ** 2) & (weakest >= cv2.dilate(weakest, around))
    peak &= (sees[middle::factor, middle::factor][:rows, :columns] > 0) & (cv2.dilate(near, around) == 0)
    v, u = np.nonzero(peak)
    best = np.argsort(-weakest[v, u], kind="stable")[:most]
    x = np.stack([u[best], v[best]], -1) * factor + middle
    return Corners(x, noise / np.sqrt(weakest[v[best], u[best]]) * factor)


def enough_texture(images: Sequence[np.ndarray]) -> tuple[bool, str]:
    """Whether features can be followed through such images.

    Returns:
        enough: Whether most of them have features in most parts.
        reason: The numbers, in a few words.
    """
    usable = [image for image in images if min(image.shape) >= _LEAST_TEXTURED_SIDE]
    if not usable:
        return False, "no image is large enough"
    counts = [_count(image) for image in usable]
    number = int(np.median([count for count, _ in counts]))
    cells = int(np.median([cell for _, cell in counts]))
    if number < _FEWEST:
        return False, f"{number} features in an image, expected at least {_FEWEST}"
    if cells < _FEWEST_CELLS:
        parts = _CELLS[0] * _CELLS[1]
        return False, f"features in {cells} of {parts} parts of an image, expected at least {_FEWEST_CELLS}"
    return True, f"{number} features in an image"


def _count(image: np.ndarray) -> tuple[int, int]:
    """Features of one image, and cells of a grid that have some."""
    rows, columns = image.shape
    everywhere, none = np.full(image.shape, 255, np.uint8), np.zeros((0, 2), int)
    found = find_features(image, everywhere, none, max(4, min(image.shape) // 60), 2000)
    cell = found.x[:, 1] * _CELLS[1] // rows * _CELLS[0] + found.x[:, 0] * _CELLS[0] // columns
    return len(found.x), len(np.unique(cell))


# Features followed through the unrolled images of a turning camera.


_FEATURES = 300
"""Most features that are followed at a time."""
_LEVELS, _WINDOW = 3, (21, 21)
_BACK_PX = 0.5
"""A feature that is followed forward and back returns to its place within this [px]."""
_MOST_DIFFERENT = 0.35
"""Largest difference from the piece in which a feature began, over its contrast."""
_LONGEST = 40
"""Most images in which a feature is followed: after that its patch looks different."""


class _Alive(NamedTuple):
    """Features that are being followed."""

    track: np.ndarray
    x: np.ndarray
    """Unrolled place in the last image [n, 2], px from its first pixel."""
    drift: np.ndarray
    """Last place less its prediction [n, 2], px: the next prediction errs by as much."""
    age: np.ndarray
    patches: Patches

    def take(self, index: np.ndarray) -> "_Alive":
        x, drift, age = self.x[index], self.drift[index], self.age[index]
        return _Alive(self.track[index], x, drift, age, take(self.patches, index))


def follow_features(images: Iterator[np.ndarray], walk: Walk) -> Followed:
    """Follow features from image to image, each compared with the piece of the image in which it began.

    Images are unrolled, so that a turn moves features and hardly changes their look. Pyramidal Lucas-Kanade from the
    last image, forward and back, finds the place; least squares against the first piece refines it, so
    that errors do not add up along a track.

    Returns:
        Sightings of features seen in at least two images.
    """
    maps = walk.cylinder.u.astype(np.float32), walk.cylinder.v.astype(np.float32)
    sees = _clear(walk.cylinder)
    apart = max(6, int(np.sqrt(np.count_nonzero(sees) / (2.5 * _FEATURES))))
    alive: _Alive | None = None
    before: np.ndarray | None = None
    sightings: list[tuple[np.ndarray, ...]] = []
    count = 0
    for step, image in enumerate(images):
        unrolled = np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.uint8)
        exact = Unrolled.of(image, walk.cylinder)
        if alive is not None and before is not None:
            alive, sigma = _next(alive, (before, unrolled, exact), sees, (walk, step))
            sightings.append((alive.x, sigma, np.full(len(sigma), step), alive.track))
        if step < walk.begin:
            taken = np.zeros((0, 2), int) if alive is None else np.rint(alive.x).astype(int)
            corners = find_features(unrolled, sees, taken, apart, _FEATURES - len(taken))
            new = _Alive(
                np.arange(count, count + len(corners.x)),
                corners.x.astype(np.float64),
                np.zeros((len(corners.x), 2)),
                np.zeros(len(corners.x), int),
                make_patches(exact, corners.x),
            )
            count += len(corners.x)
            sightings.append((new.x, corners.sigma, np.full(len(new.x), step), new.track))
            alive = new if alive is None else _joined(alive, new)
        elif alive is None or not len(alive.track):
            break
        before = unrolled
    return _followed(sightings, walk.cylinder)


def _next(
    alive: _Alive, images: tuple[np.ndarray, np.ndarray, Unrolled], sees: np.ndarray, at: tuple[Walk, int]
) -> tuple[_Alive, np.ndarray]:
    """The features of the first of two unrolled images that are found in the second one, and their noise there [px]."""
    (before, now, exact), (walk, step) = images, at
    corner = np.array([walk.cylinder.left, walk.cylinder.top])
    predicted = walk.predict(alive.x + corner, step - 1, step) - corner
    start = predicted + alive.drift
    keep = _seen(sees, start) & (alive.age < _LONGEST)
    alive, predicted, start = alive.take(keep), predicted[keep], start[keep]
    if not len(start):
        return alive, np.zeros(0)
    first, guess = alive.x.astype(np.float32)[:, None], start.astype(np.float32)[:, None]
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 0.02)
    window, flags = _WINDOW, cv2.OPTFLOW_USE_INITIAL_FLOW
    there, found, _ = cv2.calcOpticalFlowPyrLK(
        before, now, first, guess.copy(), winSize=window, maxLevel=_LEVELS, criteria=criteria, flags=flags
    )
    back, returned, _ = cv2.calcOpticalFlowPyrLK(
        now, before, there, first.copy(), winSize=window, maxLevel=_LEVELS, criteria=criteria, flags=flags
    )
    good = (found.ravel() > 0) & (returned.ravel() > 0) & (np.abs(back - first).max((1, 2)) < _BACK_PX)
    place = np.asarray(there, np.float64)[:, 0]
    good &= _seen(sees, place)
    matched = match(alive.patches, exact, np.where(good[:, None], place, -1.0))
    good &= matched.valid & (matched.difference < _MOST_DIFFERENT)
    drift = alive.drift + matched.x - start
    moved = alive._replace(x=matched.x, drift=drift, age=alive.age + 1)
    return moved.take(good), matched.sigma[good]


def _clear(cylinder: Cylinder) -> np.ndarray:
    """Where a whole piece lies in the image, uint8 [rows, columns]."""
    inside = ((cylinder.u >= 0) & (cylinder.v >= 0)).astype(np.uint8)
    inside = np.pad(inside, 1)
    side = 2 * (HALF + MARGIN + 1) + 1
    return cv2.erode(inside, np.ones((side, side), np.uint8))[1:-1, 1:-1]


def _seen(sees: np.ndarray, x: np.ndarray) -> np.ndarray:
    rows, columns = sees.shape
    whole = np.rint(np.clip(x, -1, max(sees.shape))).astype(int)
    inside = (whole >= 0).all(1) & (whole[:, 0] < columns) & (whole[:, 1] < rows)
    whole = np.where(inside[:, None], whole, 0)
    return inside & (sees[whole[:, 1], whole[:, 0]] > 0)


def _joined(alive: _Alive, new: _Alive) -> _Alive:
    track, x = np.concatenate([alive.track, new.track]), np.concatenate([alive.x, new.x])
    drift, age = np.concatenate([alive.drift, new.drift]), np.concatenate([alive.age, new.age])
    return _Alive(track, x, drift, age, joined([alive.patches, new.patches]))


def _followed(sightings: list[tuple[np.ndarray, ...]], cylinder: Cylinder) -> Followed:
    """Sightings of features that were seen again, in pixels."""
    if not sightings:
        return Followed(np.zeros((0, 2)), np.zeros(0), np.zeros(0, int), np.zeros(0, int))
    x, sigma, step, track = (np.concatenate(field) for field in zip(*sightings, strict=True))
    again = np.bincount(track, minlength=1)[track] > 1
    x, sigma, step, track = x[again], sigma[again], step[again], track[again]
    q, size = _pixels(cylinder, x)
    return Followed(q, sigma * size, step, np.unique(track, return_inverse=True)[1])


def _pixels(cylinder: Cylinder, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of unrolled places, and pixels of the image per unrolled pixel."""
    whole = np.floor(x).astype(int)
    column, row = whole.T
    fx, fy = (x - whole).T[..., None]
    both = np.stack([cylinder.u, cylinder.v], -1)
    a, b = both[row, column], both[row, column + 1]
    c, d = both[row + 1, column], both[row + 1, column + 1]
    q = (1 - fy) * ((1 - fx) * a + fx * b) + fy * ((1 - fx) * c + fx * d)
    area = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    return q, np.sqrt(area)


# Targets in images of rooms: corners of printed markers, and of a board that was left standing.


USUAL = ("DICT_APRILTAG_36h11", "DICT_4X4_250", "DICT_5X5_250", "DICT_6X6_250", "DICT_7X7_250")
"""Dictionaries that are tried where none is named; smaller ones have the same first markers."""
_SIGMA_PX = 0.05
"""Noise of a marker's corner [px]; the differences between images tell it better."""
_LEAST_SIDE = 32
_REFINED_PX = 4
_EDGE_PX, _ACROSS, _EDGE_SAMPLES = 4.0, 17, 24
"""Reach across an edge [px], and places across and along it at which the image is sampled."""
_LARGEST_PX = 1400
"""Largest side of the images in which dictionaries are looked for."""
_SURE = 2
"""Images that must show a dictionary's markers before it is accepted: many textures look like a marker once."""


def find_dictionary(images: Sequence[np.ndarray]) -> str | None:
    """The dictionary of the markers in some images of a room; None where there are none."""
    seen: Counter[tuple[str, int]] = Counter()
    for image in images:
        if min(image.shape) < _LEAST_SIDE:
            continue
        scale = min(1.0, _LARGEST_PX / max(image.shape))
        shown = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else image
        _, ids, _, families = _detector(USUAL).detectMarkersMultiDict(np.ascontiguousarray(shown))
        if ids is not None:
            seen.update({(USUAL[int(k)], int(i)) for k, i in zip(np.ravel(families), np.ravel(ids), strict=True)})
    sure = Counter(name for (name, _), count in seen.items() if count >= _SURE)
    return sure.most_common(1)[0][0] if sure else None


def find_targets(image: np.ndarray, board: AbstractBoard | None, dictionary: str | None) -> FoundTargets:
    """Find the corners of targets in one image; a marker that is seen twice is returned twice.

    Args:
        image: Grey, uint8 [rows, columns].
        board: A board that was left standing.
        dictionary: OpenCV's name of the markers' dictionary; None: no markers are looked for.

    Returns:
        "marker 7 corner 2" (corners clockwise from the top left one) and "board corner 31".

    Raises:
        ValueError: If the dictionary is unknown.
    """
    names: list[str] = []
    places, sigmas = [np.zeros((0, 2))], [np.zeros(0)]
    image = np.ascontiguousarray(image)
    if dictionary is not None and min(image.shape) >= _LEAST_SIDE:
        corners, ids, _ = _detector((known_dictionary(dictionary),)).detectMarkers(image)
        numbers = [] if ids is None else [int(i) for i in np.ravel(ids)]
        for number, four in zip(numbers, corners, strict=True):
            if number in _own(board, dictionary):
                continue
            names += [f"marker {number} corner {corner}" for corner in range(4)]
            places.append(_by_edges(image, np.reshape(four, (4, 2)).astype(np.float64)))
            sigmas.append(np.full(4, _SIGMA_PX))
    if board is not None and _may_show(image, board):
        found = find_corners(image, board)
        if found is not None:
            index = np.flatnonzero(found.valid)
            names += [f"board corner {k}" for k in index]
            places.append(found.q[index])
            sigmas.append(found.sigma[index])
    return FoundTargets(tuple(names), np.concatenate(places), np.concatenate(sigmas))


def _by_edges(image: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Corners of a marker where the lines of its edges meet: the gradient at a corner itself lies inwards of it."""
    following = np.roll(corners, -1, 0)
    along = following - corners
    length = np.linalg.norm(along, axis=1)
    if length.min() < 4 * _EDGE_PX:
        return corners
    normal = np.stack([-along[:, 1], along[:, 0]], -1) / length[:, None]
    # Clear of the corners, where the next edge is near.
    clear = np.minimum(1.5 * _EDGE_PX / length, 0.35)[:, None]
    share = clear + (1 - 2 * clear) * np.linspace(0, 1, _EDGE_SAMPLES)
    r = np.linspace(-_EDGE_PX, _EDGE_PX, _ACROSS)
    point = corners[:, None] + share[..., None] * along[:, None]
    at = (point[:, :, None] + r[:, None] * normal[:, None, None]).astype(np.float32).reshape(-1, _ACROSS, 2)
    level = np.asarray(cv2.remap(image.astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR), np.float64)
    slope = np.maximum(np.diff(level, axis=1) * _outwards(corners), 0.0)
    middle = (slope * (r[1:] + r[:-1]) / 2).sum(1) / np.maximum(slope.sum(1), 1e-9)
    # The lens bends the lines: parabolas, and at a corner their tangents.
    bends = [np.polyfit(s, m, 2) for s, m in zip(share, middle.reshape(4, -1), strict=True)]

    def tangent(k: int, place: float) -> tuple[np.ndarray, np.ndarray]:
        way = along[k] + np.polyval(np.polyder(bends[k]), place) * normal[k]
        return corners[k] + place * along[k] + np.polyval(bends[k], place) * normal[k], way

    refined = np.array([_meeting(tangent(k - 1, 1.0), tangent(k, 0.0)) for k in range(4)])
    return np.where(np.abs(refined - corners).max() < _EDGE_PX, refined, corners)


def _outwards(corners: np.ndarray) -> float:
    """1 where the normals of the edges point out of the marker, else -1."""
    x, y = (corners - corners.mean(0)).T
    area = float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())
    return -1.0 if area > 0 else 1.0


def _meeting(first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """The point where two lines meet, each a point and a direction."""
    t, _ = np.linalg.solve(np.stack([first[1], -second[1]], -1), second[0] - first[0])
    return np.asarray(first[0] + t * first[1])


def _may_show(image: np.ndarray, board: AbstractBoard) -> bool:
    """Whether a board may be in the image: the search for a chessboard that is not there takes seconds."""
    if not isinstance(board, Chessboard) or isinstance(board, Charuco):
        return True
    return min(image.shape) >= _LEAST_SIDE and bool(cv2.checkChessboard(image, board.grid()))


def _own(board: AbstractBoard | None, dictionary: str) -> range:
    """Numbers of the markers that are parts of the board."""
    if isinstance(board, Charuco) and board.dictionary.split("_")[1] == dictionary.split("_")[1]:
        return range(board.columns * board.rows // 2)
    if isinstance(board, AprilGrid) and dictionary.upper() == "DICT_APRILTAG_36H11":
        return range(board.columns * board.rows)
    return range(0)


@functools.cache
def _detector(names: tuple[str, ...]) -> "cv2.aruco.ArucoDetector":
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    settings.cornerRefinementWinSize = _REFINED_PX
    dictionaries = [cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)) for name in names]
    return cv2.aruco.ArucoDetector(dictionaries, settings)


# Features and targets in laser-off images.


def feature_eyes() -> FeatureEyes:
    """The functions of this room that look at laser-off images."""
    return FeatureEyes(to_grey, enough_texture, follow_features, find_dictionary, find_targets)
