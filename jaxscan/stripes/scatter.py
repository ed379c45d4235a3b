"""How the centres of neighbouring rows scatter, compared with the promise of their sigmas."""

import functools
import itertools
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy.lib.stride_tricks import sliding_window_view

from jaxscan.stripes.correlation import INDEPENDENT, Correlation, alike_in_blocks, alike_on_mosaic


_CLASSES = 8
"""Classes of amplitude with a scale of their own."""
_LEAST = 200
"""Rows that a class needs."""
_MOST = 60_000
"""Rows that are looked at, about."""
_LARGEST = 3.0
_WIDTHS = 32, 20
"""Rows of a window about a cubic: the narrow one is for surfaces that no wide cubic fits."""
_LAGS = 6
"""Distances of rows whose correlation is learned there."""
_RELIEF = np.array([0.25, 0.375])
"""Lengths of the relief that a cubic leaves of a surface, over those of windows [1]: it is no error."""
_SLOPES = (0.0, 0.003, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, np.inf)
"""Limits of classes of slope [px/row]: in the first a stripe stays at its place in the pixel."""
_PARTS, _MANY, _WINDOWS, _CALM_WINDOWS = 3, 30, 8, 2.5
"""Classes of sigma in each of them; windows of one where there are several, and where there is one; and scatter over
the usual one up to which they count, as edges lie in the others."""
_ROUGH, _STEEP, _SHOWN = 4.0, 0.2, 1.3
"""Variance about a cubic over that of differences, from which a cubic is no surface; slope from which a stripe passes
all places in a window [px/row]; and how much more variance steep windows then have at least, where the place matters.
"""
_NOTICED, _LUCK, _ALIKE_ROWS = 0.05, 3.0, 0.2
"""Least correlation that is noticed; standard deviations by which that of next rows is no luck; and that from which
frames are no plain ones."""
_FEW = 0.01
"""Least deviation of the mean products of windows, over that of squares [1]."""
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
    """Amplitudes of the stripes [DN]."""


class Scatter(NamedTuple):
    """The scatter of rows around a smooth surface."""

    scale: Float[np.ndarray, "profiles lines"]
    """Factor by which the sigma of every row is too small [1]."""
    common: Float[np.ndarray, "profiles lines"]
    """Part of the variance of every row that its neighbours share, so that no average makes it smaller [1]."""
    correlation: Correlation
    """Correlation of the errors of neighbouring rows: blur, demosaicing and compression spread them over several."""


class ScatterLaw(NamedTuple):
    """The scatter of the rows of one laser, by their amplitude and their sigma; of any of its profiles (`of`)."""

    spreads: tuple[tuple[np.ndarray, np.ndarray], ...]
    """Spread over the promised sigma by second and fourth differences: amplitudes, and values there."""
    usual: tuple[np.ndarray, np.ndarray]
    """Amplitudes, and usual sigmas there [px]."""
    common: tuple[tuple[float, float, float], ...]
    """Parts of the variance that neighbours share, from one to another sigma over the usual one."""
    correlation: Correlation
    """See `Scatter`."""
    variance: float = 1.0
    """Where rows are alike, their variance over the promised one, less that of `Correlation.mosaic_px` [1]."""

    def with_mosaic(self, sigma_px: float) -> "ScatterLaw":
        """This law with one more error, which depends on the place on a mosaic [px]."""
        together = float(np.hypot(self.correlation.mosaic_px, sigma_px))
        return self._replace(correlation=self.correlation._replace(mosaic_px=together))

    def of(self, rows: ProfileRows) -> Scatter:
        """The scatter of some profiles."""
        sigma, amplitude = np.asarray(rows.sigma), np.asarray(rows.amplitude, np.float32)
        # The smaller of both counts, and less than 1 counts as 1.
        if self.correlation != INDEPENDENT:
            floor = (self.correlation.mosaic_px / np.maximum(sigma, 1e-9)) ** 2
            scale = np.sqrt(np.maximum(self.variance + floor, 1.0)).astype(sigma.dtype)
        elif any(np.all(values <= 1) for _, values in self.spreads):
            scale = np.ones_like(sigma)
        else:
            scale = np.minimum(*(_interpolated(amplitude, *spread) for spread in self.spreads))
            scale = np.clip(scale, 1.0, _LARGEST).astype(sigma.dtype)
        common = np.zeros_like(sigma)
        doubt = _doubt(rows, self.usual) if self.common else sigma
        for low, high, share in self.common:
            common[(doubt >= low) & (doubt < high)] = share
        return Scatter(scale, common, self.correlation)


_ALIKE = (np.zeros(1), np.ones(1))
_NOTHING = ScatterLaw((_ALIKE, _ALIKE), _ALIKE, (), INDEPENDENT)


def scatter_law(rows: ProfileRows, line_step: int = 1) -> ScatterLaw:
    r"""The scatter of the rows of one laser, along the stripe.

    $u_{i-2k} - 4 u_{i-k} + 6 u_i - 4 u_{i+k} + u_{i+2k}$ of a smooth and curved surface is noise alone. Its spread
    for k = 2 over its promised standard deviation, in classes of amplitude, is the scale; where second differences
    spread less, as between many edges, those count. A difference far beyond the others' spread is an edge, and left
    out. Rows that are alike cancel in differences: where there are such rows, `_learned` says what they all err by.
    Both are clamped: a scale below 1 is 1, a correlation below 0 is 0.

    A row whose sigma is far over that of others as bright doubts its centre: an edge of the paint may lie under the
    stripe. Where such rows scatter less than they promise, they err together.

    Args:
        rows: All rows of the laser.
        line_step: Distance of the lines on which the laser's colour is seen.
    """
    count, lines = rows.u.shape
    if count == 0 or lines == 0:
        return _NOTHING
    some = evenly_chosen(rows)
    with ThreadPoolExecutor(1) as pool:
        windows = pool.submit(lambda: [_windows(some, line_step, width) for width in _WIDTHS])
        doubted = pool.submit(_doubted, some, line_step)
        wide = [_differences(some, 2 * line_step, weights) for weights in (_SECOND, _FOURTH)]
        spreads = tuple(_by_amplitude(*one) for one in wide)
        least = min(_spread(one) for one, _ in wide)
        learned = _learned(windows.result(), least**2, mosaic=line_step > 1)
        usual, common = doubted.result()
    return ScatterLaw(spreads, usual or _ALIKE, common, *learned)


def evenly_chosen(rows: ProfileRows) -> ProfileRows:
    """Some profiles of them, evenly spread: records of one kind may come in turn with others."""
    count, lines = rows.u.shape
    chosen = np.unique(np.linspace(0, count - 1, min(-(-_MOST // max(lines, 1)), count)).round().astype(int))
    return ProfileRows(*(np.asarray(field)[chosen] for field in rows))


class _Windows(NamedTuple):
    """Windows of neighbouring rows without a gap, about as steep and with about the same promise."""

    width: int
    """Rows of each."""
    products: Float[np.ndarray, " distances"]
    """Mean of the products of errors about a cubic, for each distance of rows, over the promised variance [1]."""
    deviation: Float[np.ndarray, " distances"]
    """Standard deviation of these means."""
    slope: Float[np.ndarray, " windows"]
    """Absolute slope of the stripe [px/row]."""
    information: float
    """Mean of 1 over the promised variance [1/px^2]."""
    usual: float
    """Variance about a cubic, as the median window has it, over the promised one [1]."""


def _windows(rows: ProfileRows, line_step: int, width: int) -> list[_Windows]:
    x = np.arange(width) - 0.5 * (width - 1)
    centres, sigmas = [np.zeros((0, width))], [np.zeros(0)]
    for first in range(line_step if rows.u.shape[1] >= width * line_step else 0):
        own = (field[:, first::line_step] for field in (rows.u, rows.sigma, rows.valid))
        u, sigma, valid = (sliding_window_view(part, width, 1)[:, :: width // 2] for part in own)
        whole = valid.all(2)
        u = u[whole].astype(np.float64)
        centres.append(u - u.mean(1, keepdims=True))
        sigmas.append(np.maximum(np.sqrt(np.mean(sigma[whole].astype(np.float64) ** 2, 1)), 1e-9))
    u, sigma = np.concatenate(centres), np.concatenate(sigmas)
    slope, left = np.abs(u @ x) / (x @ x), cubic_rest(width)
    found = []
    for low, high in itertools.pairwise(_SLOPES):
        mine = np.flatnonzero((slope >= low) & (slope < high))
        parts = int(np.clip(len(mine) // _MANY, 1, _PARTS))
        for part in np.array_split(mine[np.argsort(sigma[mine])], parts) if len(mine) >= _WINDOWS else ():
            residuals = u[part] @ left / sigma[part, None]
            squares = np.sum(residuals**2, 1) / (width - 4.0)
            usual = float(np.median(squares))
            if usual == 0.0:
                # Exact centres show no errors.
                continue
            calm = squares < _CALM_WINDOWS * usual
            residuals, part = residuals[calm], part[calm]
            lags = range(width // 2 - 1)
            products = np.stack([np.sum(residuals[:, : width - k] * residuals[:, k:], 1) for k in lags], 1)
            # Windows overlap; and the scatter of few is uncertain itself.
            deviation = np.hypot(products.std(0) / np.sqrt(len(part) / 1.5), _FEW * products[:, 0].mean())
            information = float(np.mean(sigma[part] ** -2.0))
            found.append(_Windows(width, products.mean(0), deviation, slope[part], information, usual))
    return found


def _learned(widths: list[list[_Windows]], least: float, *, mosaic: bool) -> tuple[Correlation, float]:
    """Correlation of the errors, and their variance over the promised one.

    An upright stripe keeps its place in the pixel, and what depends on it is an error of all of its rows, which none of
    them shows. Steeper stripes of the same laser show it.

    Args:
        widths: Windows, the widest first; of the widest in which a cubic fits the errors are learned.
        least: Variance over the promised one as differences have it.
        mosaic: Whether other colours lie between the samples: then there is no demosaicing or compression.
    """
    for windows in widths:
        flat = [one for one in windows if one.slope.max() < _SLOPES[1]] or windows
        still = np.median([one.usual for one in flat]) if flat else np.inf
        if still <= _ROUGH * least:
            break
    else:
        return INDEPENDENT, 1.0
    steep = [one.usual for one in windows if one.slope.min() >= _STEEP]
    first = _fitted(flat, None)
    by_blocks = by_mosaic = 0.0
    # Frames whose next rows are alike were demosaiced or compressed.
    made = first[1] > _ALIKE_ROWS * first[0] and len(steep) > 0 and np.median(steep) > _SHOWN * still
    if mosaic or made:
        near = tuple(np.round(first[1 : 1 + _LAGS] / max(first[0], 1e-9), 3))
        found = _fitted(windows, near, compressed=not mosaic)
        by_blocks, by_mosaic = found[-2:]
    else:
        found = _fitted(windows, None)
    own = found[0]
    if own <= 0:
        return INDEPENDENT, 1.0
    near = found[1 : 1 + _LAGS] / own
    count = sum(len(one.slope) for one in windows)
    noticed = near > _NOTICED
    noticed[0] &= near[0] > _LUCK / np.sqrt(windows[0].width * count)
    near = near[: np.argmin(np.append(noticed, False))]
    if not len(near) and by_blocks + by_mosaic == 0:
        return INDEPENDENT, 1.0
    correlation = Correlation(tuple(near.tolist()), float(by_blocks / (own + by_blocks)), float(np.sqrt(by_mosaic)))
    return correlation, float(own + by_blocks)


def _fitted(windows: Sequence[_Windows], near: tuple[float, ...] | None, *, compressed: bool = True) -> np.ndarray:
    """Covariances by which the products of windows are explained: of rows 0, 1, ... apart; of the
    relief of each kind of windows; of errors in the blocks of a compression, all over the promised variance; and by the
    place in a mosaic [px^2].

    Args:
        near: Correlation of next rows, by which demosaicing makes the error of steep stripes less; None: without
            errors by the place in the pixel.
        compressed: Whether frames may have been.
    """
    designs = []
    for k, one in enumerate(windows):
        lag, slope = np.arange(one.width), one.slope[:, None]
        relief = np.zeros((len(windows), len(_RELIEF), one.width))
        relief[k] = np.exp(-0.5 * (lag / (_RELIEF[:, None] * one.width)) ** 2)
        kinds = [np.eye(one.width)[: _LAGS + 1], *relief]
        if near is not None:
            by_mosaic = one.information * alike_on_mosaic(lag, slope, near)
            kinds.append(np.stack([compressed * alike_in_blocks(lag * slope).mean(0), by_mosaic.mean(0)]))
        designs.append((_products(np.concatenate(kinds)) / one.deviation).T)
    values = [one.products / one.deviation for one in windows]
    return _least_squares(np.concatenate(designs), np.concatenate(values))


def _least_squares(design: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Coefficients of which none is negative: one after the other the most negative one is left out."""
    size = np.maximum(np.linalg.norm(design, axis=0), 1e-12)
    design = design / size
    found, used = np.zeros(design.shape[1]), np.ones(design.shape[1], bool)
    while used.any():
        part = np.linalg.lstsq(design[:, used], values, rcond=None)[0]
        if part.min() >= 0:
            found[used] = part
            break
        used[np.flatnonzero(used)[np.argmin(part)]] = False
    return found / size


@functools.cache
def cubic_rest(width: int) -> np.ndarray:
    """The projection onto what a cubic leaves."""
    basis, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, width), 4))
    return np.eye(width) - basis @ basis.T


@functools.cache
def _seen(width: int) -> np.ndarray:
    """Mean products about a cubic of rows so far apart, where errors are alike just so far apart."""
    left, apart = cubic_rest(width), np.abs(np.subtract.outer(np.arange(width), np.arange(width)))
    about = [left @ (apart == k) @ left for k in range(width)]
    return np.array([[np.trace(one, k) for k in range(width // 2 - 1)] for one in about])


def _products(covariances: Float[np.ndarray, "kinds rows"]) -> Float[np.ndarray, "kinds distances"]:
    """Mean products about a cubic of rows so far apart, where errors have such covariances of the next rows."""
    return covariances @ _seen(covariances.shape[1])


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
    """Absolute differences of rows that are `apart`, over their promised standard deviation; and amplitudes."""
    count, length = rows.u.shape[0], max(rows.u.shape[1] - (len(weights) - 1) * apart, 0)
    parts = [np.s_[:, k * apart : k * apart + length] for k in range(len(weights))]
    whole = np.logical_and.reduce([rows.valid[part] for part in parts])
    # All rows are added up: picking the whole ones out of every part takes longer than adding the others too.
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
