r"""What a colour mosaic does to centres, learned from steep stripes and taken back.

A mosaic has the laser's colour on every second pixel. What a program fills in between is no Gaussian, so the
error of a centre depends on its place p on the mosaic, as a wave with a period of two pixels:
$a \cos(\pi p) + b \sin(\pi p)$. An upright stripe keeps its place, and nothing in its rows shows the error; a steep one
passes all places within a few rows.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.lib.stride_tricks import sliding_window_view

from jaxscan.stripes.correlation import alike_on_mosaic
from jaxscan.stripes.scatter import ProfileRows, cubic_rest, evenly_chosen


_WIDTH = 32
"""Rows of a window in which a stripe is compared with a cubic."""
_PERIOD_PX, _STEEPEST = 2.0, 0.8
"""How far a stripe must move in a window to show a wave [px]; and the slope up to which it is one surface [px/row]."""
_CALM, _WINDOWS = 2.5, 30
"""Largest scatter of a window over the usual one, since those with more contain edges; and the fewest windows."""
_LEAST = 0.3
"""Least part of the scatter that a wave must explain: where there is only compression, it explains a tenth [1]."""
_MOST_PX = 0.3
"""Largest amplitude [px]: with a larger one, two places would have the same centre."""
_LEFT = 0.25
"""Part of a wave that remains, because bright and faint, or upright and steep stripes differ that much in it."""
_NEAR, _STRAIGHT_PX = 8, 0.5
"""Neighbours on either side whose mean gives the place; and how far off a straight line a surface may be [px]."""
_ROUNDS, _STEPS = 8, 20


class Wave(NamedTuple):
    """What a mosaic does to centres."""

    error: Float[np.ndarray, "profiles lines"]
    """Error of each centre [px]."""
    left_px: float
    """Standard deviation of the error that remains in an upright stripe [px]."""


def mosaic_wave(rows: ProfileRows, near: tuple[float, ...], line_step: int = 1) -> Wave | None:
    """The error of centres by their place on a mosaic; None where the rows show none.

    Args:
        rows: All rows of a laser.
        near: Correlation of the noise of next rows: the filter that causes it also weakens the wave of a steep stripe.
        line_step: Distance of the lines on which the laser's colour is seen.
    """
    some = evenly_chosen(rows)
    windows = [np.zeros((0, _WIDTH))] * 2
    for first in range(line_step if rows.u.shape[1] >= _WIDTH * line_step else 0):
        u, sigma, valid = (
            sliding_window_view(field[:, first::line_step], _WIDTH, 1)[:, :: _WIDTH // 2]
            for field in (some.u, some.sigma, some.valid)
        )
        way = np.abs(u[..., -1] - u[..., 0])
        there = valid.all(2) & (way > _PERIOD_PX) & (way < _STEEPEST * _WIDTH)
        windows = [np.concatenate(pair) for pair in zip(windows, (u[there], sigma[there]), strict=True)]
    u, sigma = windows[0].astype(np.float64), np.sqrt(np.mean(np.square(windows[1], dtype=np.float64), 1))
    if len(u) < _WINDOWS or sigma.min() <= 0:
        return None
    left = cubic_rest(_WIDTH)
    rest = (u - u.mean(1, keepdims=True)) @ left / sigma[:, None]
    square = np.sum(rest**2, 1)
    calm = square < _CALM * np.median(square)
    u, sigma, rest = u[calm], sigma[calm, None], rest[calm]
    passed = _passed(np.abs(u[:, -1:] - u[:, :1]) / (_WIDTH - 1.0), near)
    wave, seen = np.zeros(2), rest.reshape(-1)
    for _ in range(_ROUNDS):
        phase = np.pi * _places(u, wave, passed, lambda place: place - place @ left)
        design = np.stack([(passed * part(phase)) @ left / sigma for part in (np.cos, np.sin)], -1).reshape(-1, 2)
        found, *_ = np.linalg.lstsq(design, seen, rcond=None)
        if np.sum((seen - design @ found) ** 2) >= (1.0 - _LEAST) * np.sum(seen**2):
            return None
        wave = 0.5 * (wave + found)
        wave *= min(1.0, _MOST_PX / max(float(np.hypot(*wave)), 1e-9))
    u = np.asarray(rows.u, np.float64)
    passed = _passed(_slopes(rows, line_step), near)
    place = _places(u, wave, passed, _means(rows, line_step))
    error = np.where(rows.valid, _error(place, wave, passed), 0.0)
    return Wave(error.astype(np.float32), _LEFT * float(np.hypot(*wave) / np.sqrt(2.0)))


def _passed(slope: np.ndarray, near: tuple[float, ...]) -> np.ndarray:
    """Amplitude of a steeper stripe's wave, as a part of that of an upright one [1]."""
    return np.asarray(np.sqrt(alike_on_mosaic(np.zeros(1), slope, near)))


def _error(place: np.ndarray, wave: np.ndarray, passed: np.ndarray) -> np.ndarray:
    return np.asarray(passed * (wave[0] * np.cos(np.pi * place) + wave[1] * np.sin(np.pi * place)))


def _places(
    u: np.ndarray, wave: np.ndarray, passed: np.ndarray, smooth: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """True places of stripes whose centres are seen at `u`, smoothed over their neighbours [px]."""
    place = smooth(u)
    for _ in range(_STEPS):
        place = 0.5 * (place + smooth(u - _error(place, wave, passed)))
    return place


def _means(rows: ProfileRows, line_step: int) -> Callable[[np.ndarray], np.ndarray]:
    """A function that averages each row and its neighbours, but leaves rows alone that are not on a straight line."""
    reach = _NEAR * line_step
    if rows.u.shape[1] <= 2 * reach:
        return lambda values: values
    inner = np.s_[:, reach:-reach]
    parts = [
        np.s_[:, reach + k * line_step : rows.u.shape[1] - reach + k * line_step] for k in range(-_NEAR, _NEAR + 1)
    ]
    straight = np.abs(rows.u[parts[0]] + rows.u[parts[-1]] - 2.0 * rows.u[inner]) < _STRAIGHT_PX
    straight &= np.logical_and.reduce([rows.valid[part] for part in parts])

    def means(values: np.ndarray) -> np.ndarray:
        found = values.copy()
        found[inner] = np.where(straight, sum(values[part] for part in parts) / len(parts), values[inner])
        return found

    return means


def _slopes(rows: ProfileRows, line_step: int) -> np.ndarray:
    """Absolute slope of the stripe at each row, taken on its less steep side; 0 where it is not known [px/row]."""
    reach, slope = _WIDTH // 4 * line_step, np.zeros_like(rows.u, np.float64)
    if rows.u.shape[1] <= 2 * reach:
        return slope
    rise = np.abs(rows.u[:, reach:] - rows.u[:, :-reach]) / (reach / line_step)
    rise = np.where(rows.valid[:, reach:] & rows.valid[:, :-reach], rise, 0.0)
    slope[:, reach:-reach] = np.minimum(np.minimum(rise[:, :-reach], rise[:, reach:]), _STEEPEST)
    return slope
