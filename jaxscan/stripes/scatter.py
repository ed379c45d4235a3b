"""How the centres of neighbouring rows scatter, compared with the promise of their sigmas."""

import functools
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy.lib.stride_tricks import sliding_window_view

from jaxscan.stripes.correlation import INDEPENDENT, Correlation, alike_in_pixel


_CLASSES = 8
"""Classes of amplitude with a scale of their own."""
_LEAST = 200
"""Rows that a class needs."""
_MOST = 60_000
"""Rows that are looked at, about."""
_LARGEST = 3.0
_WIDE, _NARROW = 32, 20
"""Rows of a window about a cubic: the narrow one is for surfaces that no wide cubic fits."""
_LAGS = {_WIDE: 6, _NARROW: 4}
"""Distances of rows whose correlation is learned there."""
_PRODUCTS = {_WIDE: 14, _NARROW: 10}
"""Distances of rows whose products are looked at there."""
_RELIEF = {_WIDE: (8.0, 12.0), _NARROW: (5.0, 8.0)}
"""Lengths of the relief that a cubic leaves of a surface [rows]: it is no error."""
_UPRIGHT, _STEEP = 0.02, 0.25
"""Slopes up to which a stripe stays at its place in the pixel, and from which it passes all places in a window
[px/row]."""
_WINDOWS, _MANY, _CALM_WINDOWS, _ROUGH, _CURVED = 30, 300, 2.5, 4.0, 2.0
"""Windows that are needed, and upright ones with which others have no part; scatter over the usual one up to which they
count, as edges lie in the others; scatter over that of differences, from which a cubic is no surface; and over that of
narrow windows, from which steep surfaces are curved."""
_OF_UPRIGHT = 0.7
"""Part of the error that steep stripes show and upright ones have too: compression keeps upright lines better."""
_NOTICED, _LUCK, _PIXEL = 0.05, 3.0, 0.3
"""Least correlation that is noticed; standard deviations by which that of next rows is no luck; and least error by the
place in the pixel, over the others [1]."""
_WAYS_PX = (0.35, 0.5, 0.7, 1.0, 1.4, 2.0)
"""Ways over which an error by the place in the pixel may stay alike."""
_SECOND, _FOURTH = np.array([1.0, -2.0, 1.0]), np.array([1.0, -4.0, 6.0, -4.0, 1.0])
_DOUBTFUL, _FEWEST, _CALM = (1.5, 2.5), 40, 0.8
"""Sigmas over those of other rows as bright from which a class begins; rows that it needs; and how much of the
promised scatter it has at most, where its errors are shared."""


class ProfileRows(NamedTuple):
    """Rows of some profiles: centres, and the figures of their fits."""

    u: Float[np.ndarray, "profiles lines"]
    """Stripe centres [px]."""
    sigma: Float[np.ndarray, "profiles lines"]
    """Their standard deviations [px]."""
    valid: Bool[np.ndarray, "profiles lines"]
    """Which of them exist."""
    amplitude: Float[np.ndarray, "profiles lines"]
    """Of the stripes [DN]."""


class Scatter(NamedTuple):
    """The scatter of rows around a smooth surface."""

    scale: Float[np.ndarray, "profiles lines"]
    """Factor by which the sigma of every row is too small [1]."""
    common: Float[np.ndarray, "profiles lines"]
    """Part of the variance of every row that its neighbours share, so that no average makes it smaller [1]."""
    correlation: Correlation
    """Of the errors of neighbouring rows: blur, demosaicing and compression spread them over several."""


class ScatterLaw(NamedTuple):
    """The scatter of the rows of one laser, by their amplitude and their sigma; of any of its profiles (`of`)."""

    spreads: tuple[tuple[np.ndarray, np.ndarray], ...]
    """Spread over the promised sigma by second and fourth differences: amplitudes, and values there."""
    usual: tuple[np.ndarray, np.ndarray]
    """Amplitudes, and usual sigmas there [px]."""
    common: tuple[tuple[float, float, float], ...]
    """Parts of the variance that neighbours share, from one to another sigma over the usual one."""
    correlation: Correlation
    """As of `Scatter`."""
    hidden: float = 1.0
    """Scatter over that of differences, in which alike rows cancel [1]."""

    def of(self, rows: ProfileRows) -> Scatter:
        """The scatter of some profiles."""
        sigma, amplitude = np.asarray(rows.sigma), np.asarray(rows.amplitude, np.float32)
        # The smaller of both counts, and less than 1 counts as 1.
        if any(np.all(values * self.hidden <= 1) for _, values in self.spreads):
            scale = np.ones_like(sigma)
        else:
            scale = np.minimum(*(_interpolated(amplitude, *spread) for spread in self.spreads)) * self.hidden
            scale = np.clip(scale, 1.0, _LARGEST).astype(sigma.dtype)
        common = np.zeros_like(sigma)
        doubt = _doubt(rows, self.usual) if self.common else sigma
        for low, high, share in self.common:
            common[(doubt >= low) & (doubt < high)] = share
        return Scatter(scale, common, self.correlation)


_ALIKE = (np.zeros(1), np.ones(1))
_NOTHING = ScatterLaw((_ALIKE, _ALIKE), _ALIKE, (), INDEPENDENT)


def scatter_law(rows: ProfileRows, line_step: int = 1) -> ScatterLaw:
    r"""The scatter of the rows of one laser, from differences along the stripe.

    $u_{i-2k} - 4 u_{i-k} + 6 u_i - 4 u_{i+k} + u_{i+2k}$ of a smooth and curved surface is noise alone. Its spread
    for k = 2 over its promised standard deviation, in classes of amplitude, is the scale; where second differences
    spread less, as between many edges, those count. A difference far beyond the others' spread is an edge, and left
    out. Rows that are alike cancel in differences: `_learned` says how far they are, and what they hide. Neither is
    believed to be good news: a scale below 1 is 1, a correlation below 0 is 0.

    A row whose sigma is far over that of others as bright doubts its centre: an edge of the paint may lie under the
    stripe. Where such rows scatter less than they promise, they err together.

    Args:
        rows: All rows of the laser.
        line_step: Distance of the lines on which the laser's colour is seen.
    """
    count, lines = rows.u.shape
    if count == 0 or lines == 0:
        return _NOTHING
    # Evenly spread: records of one kind may come in turn with others.
    chosen = np.unique(np.linspace(0, count - 1, min(-(-_MOST // lines), count)).round().astype(int))
    some = ProfileRows(*(np.asarray(field)[chosen] for field in rows))
    with ThreadPoolExecutor(1) as pool:
        windows = pool.submit(lambda: [_windows(some, line_step, width) for width in (_WIDE, _NARROW)])
        doubted = pool.submit(_doubted, some, line_step)
        wide = [_differences(some, 2 * line_step, weights) for weights in (_SECOND, _FOURTH)]
        spreads = tuple(_by_amplitude(*one) for one in wide)
        least = min(_spread(one) for one, _ in wide)
        correlation, variance = _learned(windows.result(), least**2, mosaic=line_step > 1)
        usual, common = doubted.result()
    hidden = 1.0 if correlation == INDEPENDENT else float(np.sqrt(variance) / least)
    return ScatterLaw(spreads, usual or _ALIKE, common, correlation, hidden)


class _Windows(NamedTuple):
    """Windows of neighbouring rows without a gap."""

    u: Float[np.ndarray, "windows rows"]
    """Centres in their promised standard deviation."""
    slope: Float[np.ndarray, " windows"]
    """Of the stripe, absolute [px/row]."""


def _windows(rows: ProfileRows, line_step: int, width: int) -> _Windows:
    x = np.arange(width) - 0.5 * (width - 1)
    found, slopes = [np.zeros((0, width))], [np.zeros(0)]
    for first in range(line_step if rows.u.shape[1] >= width * line_step else 0):
        parts = (field[:, first::line_step] for field in (rows.u, rows.sigma, rows.valid))
        u, sigma, valid = (sliding_window_view(part, width, 1)[:, :: width // 2] for part in parts)
        whole = valid.all(2)
        u, sigma = u[whole].astype(np.float64), sigma[whole]
        u -= u.mean(1, keepdims=True)
        found.append(u / np.maximum(np.sqrt(np.mean(sigma**2, 1, keepdims=True)), 1e-9))
        slopes.append(np.abs(u @ x) / (x @ x))
    return _Windows(np.concatenate(found), np.concatenate(slopes))


def _learned(widths: Sequence[_Windows], least: float, *, mosaic: bool) -> tuple[Correlation, float]:
    """Correlation of the errors, and their variance over the promised one.

    An upright stripe keeps its place in the pixel, and what depends on it is an error of all of its rows, which none of
    them shows. Steep stripes of the same laser show it.

    Args:
        widths: Windows, the widest first; of the widest in which a cubic fits the errors are learned.
        least: Variance over the promised one as differences have it.
        mosaic: Whether other colours lie between the samples.
    """
    for windows in widths:
        upright = windows.u[windows.slope < _UPRIGHT]
        learned = _covariance(upright if len(upright) >= _MANY else windows.u)
        if learned is not None and learned.usual <= _ROUGH * least and learned.near[0] > 0:
            break
    else:
        return INDEPENDENT, 1.0
    own, near = learned.near[0], learned.near[1:] / learned.near[0]
    noticed = near > _NOTICED
    noticed[0] &= near[0] > _LUCK / np.sqrt(windows.u.shape[1] * learned.windows)
    near = near[: np.argmin(np.append(noticed, False))]
    share, place = own * near, None
    if len(near) or mosaic:
        place = _place_in_pixel(widths, upright, share)
    if place is None:
        return (Correlation(tuple(near.tolist())), float(own)) if len(near) else (INDEPENDENT, 1.0)
    variance, way_px = place
    whole = own + variance
    return Correlation(tuple((share / whole).tolist()), float(variance / whole), way_px), float(whole)


def _place_in_pixel(widths: Sequence[_Windows], upright: np.ndarray, near: np.ndarray) -> tuple[float, float] | None:
    """Variance of the error by the place in the pixel, over the promised one, and the way over which it stays alike
    [px]; None where steep stripes do not show it.

    Args:
        widths: Windows, the widest first; they are taken unless only narrower ones are as a cubic is.
        upright: Those of upright stripes, of any width.
        near: Covariance of other errors with the next rows.
    """
    slopes = [windows.slope[windows.slope >= _STEEP] for windows in widths]
    each = [_covariance(windows.u[windows.slope >= _STEEP]) for windows in widths]
    wide, narrow = each
    at = 0 if wide is not None and narrow is not None and wide.usual < _CURVED * narrow.usual else 1
    shown, still = each[at], _covariance(upright)
    if shown is None or still is None or shown.near[0] < (1.0 + _PIXEL) * still.near[0]:
        return None
    variance, lag = shown.near[0] - still.near[0], np.arange(1, len(shown.near))
    other = np.append(near, np.zeros(len(lag)))[: len(lag)]
    moved = slopes[at][:, None] * lag
    misfit = [np.sum((shown.near[1:] - other - variance * alike_in_pixel(moved, way).mean(0)) ** 2) for way in _WAYS_PX]
    return _OF_UPRIGHT * float(variance), _WAYS_PX[int(np.argmin(misfit))]


class _Covariance(NamedTuple):
    near: np.ndarray
    """Of rows 0, 1, ... apart, over the promised variance [1]."""
    usual: float
    """Variance about a cubic, as the median window has it."""
    windows: int
    """That were looked at."""


def _covariance(windows: np.ndarray) -> _Covariance | None:
    """The covariance of errors in windows: what is left about a cubic is that of errors, of which the cubic takes a
    part, and that of a relief."""
    width = windows.shape[1]
    left, known = _cubic(width)
    residuals = windows @ left
    if len(residuals) < _WINDOWS:
        return None
    squares = np.sum(residuals**2, 1) / (width - 4.0)
    usual = float(np.median(squares))
    residuals = residuals[squares < _CALM_WINDOWS * usual]
    if len(residuals) < _WINDOWS:
        return None
    lags = range(_PRODUCTS[width] + 1)
    products = np.stack([np.sum(residuals[:, : width - k] * residuals[:, k:], 1) for k in lags], 1)
    weight = 1.0 / np.maximum(products.std(0), 1e-12)
    found = _least_squares(known * weight[:, None], products.mean(0) * weight)
    return _Covariance(found[: _LAGS[width] + 1], usual, len(residuals))


def _least_squares(design: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Coefficients of which none is negative: one after the other the most negative one is left out."""
    found, used = np.zeros(design.shape[1]), np.ones(design.shape[1], bool)
    while used.any():
        part = np.linalg.lstsq(design[:, used], values, rcond=None)[0]
        if part.min() >= 0:
            found[used] = part
            break
        used[np.flatnonzero(used)[np.argmin(part)]] = False
    return found


@functools.cache
def _cubic(width: int) -> tuple[np.ndarray, np.ndarray]:
    """The projection onto what a cubic leaves; and the products there of rows that are alike only so far apart, or by
    a relief."""
    basis, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, width), 4))
    left, apart = np.eye(width) - basis @ basis.T, np.abs(np.subtract.outer(np.arange(width), np.arange(width)))
    kinds = [(apart == k).astype(float) for k in range(_LAGS[width] + 1)]
    kinds += [np.exp(-0.5 * (apart / length) ** 2) for length in _RELIEF[width]]
    lags = range(_PRODUCTS[width] + 1)
    return left, np.array([[np.trace(left @ kind @ left, k) for kind in kinds] for k in lags])


def _by_amplitude(scattered: np.ndarray, level: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Amplitudes, and the spread of rows that have them; 1 where too few are known."""
    classes = int(np.clip(len(level) // _LEAST, 0, _CLASSES))
    if classes == 0:
        return _ALIKE
    ranks = np.array_split(np.argsort(level), classes)
    middle = np.array([_middle(level[rank]) for rank in ranks])
    return middle, np.array([_spread(scattered[rank]) for rank in ranks])


def _interpolated(x: np.ndarray, known: np.ndarray, values: np.ndarray) -> np.ndarray:
    """`np.interp` of a grid, which would be in double precision."""
    out = np.empty(x.shape, np.float32)
    for to, row in zip(out, x, strict=True):
        to[:] = np.interp(row, known, values)
    return out


def _usual(some: ProfileRows) -> tuple[np.ndarray, np.ndarray] | None:
    """Amplitudes, and usual sigmas there; None where too few rows are known."""
    level, sigma = (field[some.valid] for field in (some.amplitude, some.sigma))
    classes = int(np.clip(len(level) // _LEAST, 0, _CLASSES))
    if classes == 0:
        return None
    ranks = np.array_split(np.argsort(level), classes)
    middle = np.array([float(_middle(level[rank])) for rank in ranks])
    usual = np.array([float(np.median(sigma[rank])) for rank in ranks])
    return middle, np.maximum(usual, 1e-9)


def _middle(ordered: np.ndarray) -> np.floating:
    """The median of sorted values, without the search for it."""
    count = len(ordered)
    return np.mean(ordered[(count - 1) // 2 : count // 2 + 1])


def _doubt(rows: ProfileRows, usual: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Sigmas over those of other rows as bright."""
    return np.asarray(rows.sigma) / _interpolated(np.asarray(rows.amplitude, np.float32), *usual)


def _doubted(
    some: ProfileRows, line_step: int
) -> tuple[tuple[np.ndarray, np.ndarray] | None, tuple[tuple[float, float, float], ...]]:
    usual = _usual(some)
    return usual, () if usual is None else _common(some, usual, line_step)


def _common(
    some: ProfileRows, usual: tuple[np.ndarray, np.ndarray], line_step: int
) -> tuple[tuple[float, float, float], ...]:
    """The part of the variance that neighbours share, in classes of doubt."""
    # All three rows in the middle of a difference.
    own = _doubt(some, usual)
    least = np.minimum(np.minimum(own, np.roll(own, line_step, 1)), np.roll(own, -line_step, 1))
    scattered, at = _differences(some._replace(amplitude=least), line_step, _FOURTH)
    found = []
    for low, high in zip(_DOUBTFUL, (*_DOUBTFUL[1:], np.inf), strict=True):
        mine = scattered[(at >= low) & (at < high)]
        spread = _spread(mine) if len(mine) >= _FEWEST else 1.0
        if spread < _CALM:
            found.append((low, high, 1.0 - spread**2))
    return tuple(found)


def _differences(rows: ProfileRows, apart: int, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Differences, absolute, over their promised standard deviation, and amplitudes, of rows so far apart."""
    count, length = rows.u.shape[0], max(rows.u.shape[1] - (len(weights) - 1) * apart, 0)
    parts = [np.s_[:, k * apart : k * apart + length] for k in range(len(weights))]
    whole = np.logical_and.reduce([rows.valid[part] for part in parts])
    # Of all rows: picking the whole ones out of every part takes longer than adding up the others too.
    difference, variance = np.zeros((count, length)), np.zeros((count, length))
    square = rows.sigma**2
    for weight, part in zip(weights, parts, strict=True):
        difference += weight * rows.u[part]
        variance += weight**2 * square[part]
    promised = np.sqrt(np.maximum(variance[whole], 1e-18))
    return np.abs(difference[whole]) / promised, rows.amplitude[parts[len(weights) // 2]][whole]


def _spread(values: Float[np.ndarray, " n"]) -> float:
    """Standard deviation about 0 of the values within three of them, by iteration from their smallest fifth."""
    # A fifth of a half normal distribution lies below 0.2533 sigma; cut at 3 sigma it has 0.9866 of its sigma.
    found = float(np.quantile(values, 0.2)) / 0.2533 if len(values) else 0.0
    for _ in range(10):
        near, before = values[values <= 3.0 * found], found
        found = float(np.sqrt(np.mean(near**2))) / 0.9866 if len(near) else 0.0
        if found == before:
            break
    return found
