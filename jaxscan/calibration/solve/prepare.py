"""Observations made ready for the solver: clean, checked, and padded to few different shapes."""

from typing import NamedTuple

import numpy as np

from jaxscan.geometry import Array, fixes_plane
from jaxscan.observation import Observations


# Shapes are rounded up to these, few, so that captures of unlike sizes share a compilation, which costs
# more than many solves; the first are where the time of a solve begins to be more than overhead.
_VIEWS = (24, 72, 216, 648, 1944, 5832)
_POINTS = (64, 128, 256, 512, 1024, 2048, 4096)
_CORNERS = (96, 192, 384, 768, 1536)
_STOPS = (0, 12, 36, 108, 324)


class Prepared(NamedTuple):
    """Host arrays in float64; everything that is not valid is harmless."""

    size: tuple[int, int]
    """Width and height of the images [px]."""
    board: np.ndarray
    """Corners of the flat board [corners, 3]; padding repeats the first."""
    corner_q: np.ndarray
    corner_sigma: np.ndarray
    corner_valid: np.ndarray
    angle: np.ndarray
    placement: np.ndarray
    """Compact numbers 0 ... placements - 1; 0 for padding."""
    stop: np.ndarray
    """1 for the position of a view [views, stops] among those of its placement; 0 where that has one alone."""
    usable: np.ndarray
    """Views [views] with enough corners to fix a pose; the others are not valid anywhere."""
    stripe_q: np.ndarray
    stripe_sigma: np.ndarray
    stripe_valid: np.ndarray
    stripe_view: np.ndarray
    stripe_laser: np.ndarray
    stripe_contrast: np.ndarray
    """Contrast class of every stripe point, 0 for padding; see `StripeViews`."""


def prepare(observations: Observations) -> Prepared:
    """Drop unusable observations and pad views, stripes and points to the next bucket."""
    corners, stripes = observations.corners, observations.stripes
    board = np.asarray(observations.board.corners(), np.float64)
    centre = np.array([(observations.width - 1) / 2, (observations.height - 1) / 2])
    q, sigma, valid = _clean(corners.q, corners.sigma, corners.valid, centre)
    usable = np.array([fixes_plane(board[seen, :2]) for seen in valid], bool)
    valid &= usable[:, None]
    stripe_q, stripe_sigma, stripe_valid = _clean(stripes.q, stripes.sigma, stripes.valid, centre)
    view = np.asarray(stripes.view, np.int32)
    contrast = np.zeros(stripe_valid.shape, np.int8)
    if stripes.contrast is not None:
        # Used as an index, by points that are not valid too.
        contrast = np.where(stripe_valid, stripes.contrast, 0).astype(np.int8)
    if len(view) and len(usable):
        stripe_valid &= usable[view][:, None]
    placement = np.zeros(len(usable), np.int32)
    if usable.any():
        placement[usable] = np.unique(np.asarray(corners.placement)[usable], return_inverse=True)[1]
    angle = np.where(usable, np.asarray(corners.angle, np.float64), 0.0)
    stop = _stops(angle, placement, usable)
    views, rows = _bucket(len(usable), _VIEWS), _bucket(len(view), _VIEWS)
    points, count = _bucket(stripe_q.shape[1], _POINTS), _bucket(len(board), _CORNERS)
    return Prepared(
        size=(observations.width, observations.height),
        board=_pad(board, (count,), board[0]),
        corner_q=_pad(q, (views, count), centre),
        corner_sigma=_pad(sigma, (views, count), 1.0),
        corner_valid=_pad(valid, (views, count), False),
        angle=_pad(angle, (views,), 0.0),
        placement=_pad(placement, (views,), 0),
        stop=_pad(stop, (views,), 0.0),
        usable=_pad(usable, (views,), False),
        stripe_q=_pad(stripe_q, (rows, points), centre),
        stripe_sigma=_pad(stripe_sigma, (rows, points), 1.0),
        stripe_valid=_pad(stripe_valid, (rows, points), False),
        stripe_view=_pad(view, (rows,), 0),
        stripe_laser=_pad(np.asarray(stripes.laser, np.int32), (rows,), 0),
        stripe_contrast=_pad(contrast, (rows, points), 0),
    )


def _stops(angle: np.ndarray, placement: np.ndarray, usable: np.ndarray) -> np.ndarray:
    number, most = np.full(len(angle), -1), 0
    for one in np.unique(placement[usable]):
        views = np.flatnonzero(usable & (placement == one))
        positions, place = np.unique(angle[views], return_inverse=True)
        # The pose of a board that was seen from one position alone takes up any error of it.
        if len(positions) > 1:
            number[views], most = place, max(most, len(positions))
    return (number[:, None] == np.arange(_bucket(most, _STOPS))).astype(np.float64)


def _clean(q: Array, sigma: Array, valid: Array, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    pixel, noise = np.asarray(q, np.float64), np.asarray(sigma, np.float64)
    good = np.asarray(valid, bool) & np.isfinite(pixel).all(-1) & np.isfinite(noise) & (noise > 0)
    # An entry that is not valid must not reach any arithmetic: 0 x NaN is NaN.
    return np.where(good[..., None], pixel, centre), np.where(good, noise, 1.0), good


def _bucket(count: int, sizes: tuple[int, ...]) -> int:
    return next((size for size in sizes if size >= count), count)


def _pad(array: np.ndarray, shape: tuple[int, ...], fill: np.ndarray | float | int) -> np.ndarray:
    padded = np.empty(shape + array.shape[len(shape) :], array.dtype)
    padded[...] = fill
    padded[tuple(slice(0, n) for n in array.shape[: len(shape)])] = array
    return padded
