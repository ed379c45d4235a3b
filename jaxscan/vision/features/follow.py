"""Features followed through the unrolled images of a turning camera."""

from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np

from jaxscan.recalibration.tracks import Cylinder, Followed, Walk
from jaxscan.vision.features.patches import HALF, MARGIN, Patches, Unrolled, joined, make_patches, match, take
from jaxscan.vision.features.texture import find_features


_FEATURES = 300
"""Features that are followed at a time, at most."""
_LEVELS, _WINDOW = 3, (21, 21)
_BACK_PX = 0.5
"""A feature followed forward and back comes to its place again within this [px]."""
_MOST_DIFFERENT = 0.35
"""Difference from the piece in which a feature began, over its contrast, at most."""
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
