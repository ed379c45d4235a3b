"""Stripe centres from their neighbours along the line: a local parabola in a window that ends at edges.

A row is fitted by itself, and its bound is not the bound of a line: a surface is continuous, and its neighbours know
where the stripe is. For every centre a parabola is fitted to the centres around it, weighted by their variances. Its
value there has no bias by slope or curvature. Windows end

- at an edge: where straight lines through 3, 6 or 10 centres on either side fit better than one parabola. So steps and
  corners stay as sharp as the rows have them, if noise lets them be seen, and a curved surface is no edge;
- at a gap;
- where the parabola does not fit: of 3, 6 and 10 lines on either side each is taken as long as chi-squared passes and
  its value agrees with that of the smaller window.

Where an edge is in doubt, the values with and without it count by their odds, and their difference as uncertainty.
A centre off the line on which its four neighbours agree, a reflection or a wrong candidate, stays as it is and has no
part in others.

Where the errors of neighbouring rows are alike, the figures of fits and tests are those of their correlation: see
`correlation`.

A row adds up the moments of its own window, neighbour by neighbour, about its own line, centre and slope: the numbers
stay small, so that single precision is enough, and everything is elementwise over long rows.

Source: A. Savitzky, M. J. E. Golay, Smoothing and differentiation of data by simplified least squares procedures,
Anal. Chem. 36, 1964; windows of their own for every point: V. Katkovnik, A new method for varying adaptive bandwidth
selection, IEEE Trans. Signal Processing 47, 1999.
"""

import functools
import itertools
import operator
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float, Int

from jaxscan.compiling import compile_wide
from jaxscan.geometry import Array
from jaxscan.memory import kept
from jaxscan.stripes.correlation import (
    INDEPENDENT,
    REACH,
    SIZES,
    SLOPES,
    STRAIGHT,
    Correlation,
    Tables,
    tables_of,
    window_of,
)
from jaxscan.stripes.frames import Sites


_MARGIN = 32
"""Rows without weight on either side of a profile, so that neighbours are slices."""
_GAP = 4.0
"""Largest distance of neighbouring lines on one surface."""
_EDGE, _DOUBT, _EVEN = 12.0, 5.0, 9.0
"""Chi-squared by which two straight lines are better than a parabola, from which there is an edge; from which there may
be one; and at which that is as likely as not."""
_STRAY, _AGREE = 4.5, 16.0
"""Standard deviations by which a stray centre lies off the line through its neighbours; chi-squared of two degrees of
freedom up to which those neighbours lie on a line."""
_MISFIT, _APART = (4.0, 1.8), (3.5, 2.0)
"""Standard deviations by which the chi-squared of a fit may exceed its degrees of freedom, and by which its value may
differ from that of the smaller window. The first of each is for the smallest window, whose few degrees of freedom
scatter further; and the row itself is not better than that window unless a jump is plain."""
_LEAST_PX = 1e-4
"""Smallest standard deviation of a centre that is believed."""
_MOST = 0.99
"""Largest part of a row's variance that a mosaic makes, as far as it is believed."""
_SINGULAR = 1e-5
"""Determinant of normal equations, in the product of their diagonal, below which they determine nothing."""
_PROFILES, _FEW = 32, 8
"""Profiles that are smoothed at a time, and where there are only a few."""
_EVERY_LINE = Sites()


class Smoothed(NamedTuple):
    """Centres [profiles, lines] that use their neighbours; zero where there is no stripe."""

    u: Float[np.ndarray, "profiles lines"]
    """Stripe centre [px]."""
    sigma: Float[np.ndarray, "profiles lines"]
    """Its standard deviation [px]."""
    shared_lines: Float[np.ndarray, "profiles lines"]
    """Lines over which the noise of the centre is shared: its correlation with the k-th next line of the profile is
    about 1 - k / shared_lines; 1 where the row is by itself and no other is like it."""
    alike: Float[np.ndarray, "profiles lines"]
    """Variance of the mean of many rows over that of independent ones [1]."""


def smooth_profiles(
    u: Float[np.ndarray, "profiles lines"],
    sigma: Float[np.ndarray, "profiles lines"],
    valid: Bool[np.ndarray, "profiles lines"],
    sites: Sites = _EVERY_LINE,
    correlation: Correlation = INDEPENDENT,
) -> Smoothed:
    """Centres that use their neighbours along the stripe, and none across an edge.

    A profile depends on no other one. The mean of many smoothed centres is no better than that of the rows they were
    made of: compute with the sigmas of the rows, or with `shared_lines`.

    Args:
        u: Stripe centres of the rows [px].
        sites: Where the laser's colour is seen: a mosaic has it on every second line only.
        correlation: Of the errors of neighbouring rows that have the laser's colour.
    """
    tables = tables_of(correlation)
    lines = np.s_[:, sites.first_line :: sites.line_step]
    whole = [np.asarray(field) for field in (u, sigma, valid)]
    fields = [field[lines] for field in whole]
    found = [np.zeros(fields[0].shape, np.float32) for _ in Smoothed._fields]
    with jax.enable_x64(False):
        for first in range(0, len(fields[0]) if fields[0].size else 0, _PROFILES):
            part = [field[first : first + _PROFILES] for field in fields]
            count = len(part[0])
            # Few sizes, so that little is compiled.
            room = _PROFILES if len(fields[0]) > _FEW else _FEW if count > 1 else 1
            part = [np.pad(field, ((0, max(room - count, 0)), (0, 0))) for field in part]
            for to, field in zip(found, _smooth(*part, tables), strict=True):
                to[first : first + count] = np.asarray(field)[:count]
    if sites == _EVERY_LINE:
        return Smoothed(*found)
    smoothed = Smoothed(*(np.zeros(whole[0].shape, np.float32) for _ in found))
    found[2] = np.where(found[2] > 1, sites.line_step * found[2], found[2])
    for to, field in zip(smoothed, found, strict=True):
        to[lines] = field
    return smoothed


class _Rows(NamedTuple):
    """The valid centres of every profile, one after the other; behind the last their weight is 0."""

    x: Float[Array, "profiles rows"]
    """Line."""
    y: Float[Array, "profiles rows"]
    """Centre [px]."""
    own: Float[Array, "profiles rows"]
    """Information of the row itself [1/px^2]."""
    weight: Float[Array, "profiles rows"]
    """The same, 0 for strays."""
    ground: Float[Array, "profiles rows"]
    """Centre from which a row counts those of its neighbours; its own but of strays [px]."""
    slope: Float[Array, "profiles rows"]
    """The same for the slope [px/line]."""
    steep: Int[Array, "profiles rows"]
    """Which of `SLOPES` the stripe has, of ten lines."""
    thin: Float[Array, "profiles rows"]
    """Distance of the rows around [lines]."""
    mosaic: Float[Array, "profiles rows"]
    """Part of the row's variance that a mosaic makes."""

    def looked_up(self, tables: Tables, table: Array, place: Array | int) -> Array:
        """Entries of a table."""
        return _looked_up(tables, table, place, self.steep, self.thin, self.mosaic)


class _Sums(NamedTuple):
    """Moments of a window about the row's own line, centre and slope."""

    s: tuple[Array, ...]
    """Weights times the line to the power of 0 to 4."""
    t: tuple[Array, ...]
    """Weights times the centre and the line to the power of 0 to 2."""
    q: Array
    """Weights times the square of the centre."""
    rows: Array
    """Number of rows with a weight."""


@compile_wide
def _smooth(u: Array, sigma: Array, valid: Array, tables: Tables) -> tuple[Array, ...]:
    """Smooth the profiles of one laser; the fields of `Smoothed`."""
    keep = functools.partial(kept, jnp.any(valid))

    def padded(make: Callable, *fields: Any) -> Any:
        return keep(lambda field: jnp.pad(field, ((0, 0), (_MARGIN, _MARGIN))), keep(make, *fields))

    def pair(make: Callable, *fields: Any) -> tuple[Array, Array]:
        # A complex number holds two results: with two arrays, everything before them would be computed twice.
        both = keep(lambda *given: lax.complex(*(part.astype(jnp.float32) for part in make(*given))), *fields)
        return both.real, both.imag

    number, x, y, own = keep(_packed, u, sigma, valid)
    gap, near = padded(_gaps, x, own), keep(_near, x)
    steep, thin = keep(_steepness, x, y, own)
    mosaic = keep(lambda own: jnp.minimum(tables.mosaic * _shifted(own), _MOST), own)
    ground, slope = pair(functools.partial(_grounds, tables), x, y, own, gap, steep, mosaic)
    weight = padded(lambda own, y: jnp.where(_shifted(y) == ground, _shifted(own), 0.0), own, y)
    rows = _Rows(x, y, own, weight, ground, slope, steep, thin, mosaic)

    def look_for_edges(doubt, size):
        ends = padded(_ends, gap, near, doubt)
        height = padded(functools.partial(_edge_heights, tables), rows, ends, size)
        return padded(_doubts, doubt, height, size), None

    doubt, _ = lax.scan(look_for_edges, jnp.zeros_like(x), jnp.asarray(SIZES, jnp.int32))

    def fit(state, again):
        def first(rows: _Rows, ends: Array) -> tuple[Array, ...]:
            spread, window = pair(lambda *given: _windows(tables, *given)[2:4], rows, ends)
            word = window.astype(jnp.int32)
            most, at = pair(_most_doubtful, doubt, word)
            return _cut_short(ends, most, at.astype(jnp.int32)), spread * _lengths(rows.x, word), most

        found = pair(lambda *given: _windows(tables, *given)[:2], rows, state[0])
        return lax.cond(again, lambda *_: state, first, rows, state[0]), found

    # At first with all windows, then with windows that end at the most doubtful edge in them.
    nothing = jnp.zeros_like(rows.slope)
    start = keep(_ends, gap, near, doubt), nothing, nothing
    (_, shared, most), found = lax.scan(fit, start, np.array([False, True]))
    found = keep(_mixed, rows, found, shared, most)
    back = jnp.minimum(number, valid.shape[1] - 1)
    on_lines = lambda field: jnp.where(valid, jnp.take_along_axis(field, back, 1), 0.0)
    alike = keep(lambda rows: rows.looked_up(tables, tables.rows, 0)[..., 2], rows)
    return on_lines(found[0]), on_lines(found[1]), on_lines(found[2]), on_lines(alike)


def _packed(u: Array, sigma: Array, valid: Array) -> tuple[Array, Array, Array, Array]:
    """Which valid row of its profile each line is; and the rows' lines, centres and information, with a margin."""
    profiles, lines = u.shape
    number = jnp.where(valid, jnp.cumsum(valid, 1, dtype=jnp.int32) - 1, lines + _MARGIN)
    profile = jnp.arange(profiles, dtype=jnp.int32)[:, None]
    line = jnp.zeros((profiles, lines + 2 * _MARGIN), jnp.int32)
    line = line.at[profile, number + _MARGIN].set(jnp.arange(lines, dtype=jnp.int32)[None], mode="drop")
    row = jnp.arange(-_MARGIN, lines + _MARGIN, dtype=jnp.int32)[None]
    real = (row >= 0) & (row < jnp.sum(valid, 1, dtype=jnp.int32)[:, None])
    information = 1.0 / jnp.maximum(jnp.take_along_axis(sigma, line, 1), _LEAST_PX) ** 2
    # Behind the last row and before the first there is a gap.
    x = jnp.where(real, line, jnp.where(row < 0, -100, lines + 100)).astype(jnp.float32)
    return number, x, jnp.where(real, jnp.take_along_axis(u, line, 1), 0.0), jnp.where(real, information, 0.0)


def _shifted(field: Array, by: int = 0) -> Array:
    """A field with a margin, moved on by so many rows."""
    return field[:, _MARGIN + by : field.shape[1] - _MARGIN + by]


def _steepness(x: Array, y: Array, own: Array) -> tuple[Array, Array]:
    """Which of `SLOPES` the stripe has, and the distance of rows; the least slope there is, as edges seem steep."""
    half = SIZES[-1] // 2
    ends = [(-2 * half, 0), (-half, half), (0, 2 * half)]
    slope, thin = jnp.full(_shifted(x).shape, jnp.inf), jnp.full(_shifted(x).shape, 1.0)
    for low, high in ends:
        there = (_shifted(own, low) > 0) & (_shifted(own, high) > 0)
        over = jnp.where(there, _shifted(x, high) - _shifted(x, low), 1.0)
        rise = jnp.abs(_shifted(y, high) - _shifted(y, low)) / over
        slope = jnp.where(there, jnp.minimum(slope, rise), slope)
        thin = jnp.where(there & (low + high == 0), over / (high - low), thin)
    limits = [0.5 * (a + b) for a, b in itertools.pairwise(SLOPES)]
    steps = [(slope > limit).astype(jnp.int32) for limit in limits]
    return functools.reduce(operator.add, steps), thin


def _looked_up(tables: Tables, table: Array, place: Array | int, steep: Array, thin: Array, mosaic: Array) -> Array:
    """Entries of a table; of rows further apart they are nearer to 1."""
    size = len(table) // (2 * len(SLOPES))
    wide = lambda field: field.reshape(*field.shape, *(1,) * (table.ndim - 1))

    def entries() -> Array:
        light, other = (jnp.take(table, (kind + steep) * size + place, axis=0) for kind in (0, len(SLOPES)))
        return 1.0 + (light + wide(mosaic) * (other - light) - 1.0) / wide(thin)

    one = lambda: jnp.ones((*steep.shape, *table.shape[1:]), jnp.float32)
    return lax.cond(tables.correlated, entries, one)


def _grounds(
    tables: Tables, x: Array, y: Array, own: Array, gap: Array, steep: Array, mosaic: Array
) -> tuple[Array, Array]:
    """The centre and the slope from which each row counts those of its neighbours [px, px/line].

    The centre is the row's own, but of a stray one, that lies off the straight line on which two neighbours on either
    side agree: there it is that line's. The slope is that line's, or where there is none the one to the next row or
    from the one before, whichever is less steep: the other may lead over an edge.
    """
    near = [(_shifted(own, k), _shifted(x, k) - _shifted(x), _shifted(y, k) - _shifted(y)) for k in (-2, -1, 1, 2)]
    sums = _added(near)
    line = _solved(sums, 2)
    (p0, p1), (r0, r1), l10 = line.pivots, line.rest, line.lower[1][0]
    slope = r1 / p1
    value, variance = r0 / p0 - l10 * slope, 1.0 / p0 + l10 * l10 / p1
    # Four of them, none beyond the ends, and near.
    agree = line.known & (sums.rows == 4.0) & (near[3][1] - near[0][1] <= 4.0 + _GAP)
    expected, likely, _ = jnp.moveaxis(_looked_up(tables, tables.rows, 0, steep, jnp.ones_like(value), mosaic), -1, 0)
    agree &= sums.q - line.explained < _AGREE * expected
    alone = 1.0 / jnp.where(_shifted(own) > 0, _shifted(own), 1.0)
    stray = agree & (value * value > _STRAY**2 * likely * (variance + alone))
    sides = []
    for k, (_, over, rise) in zip((-1, 0), near[1:3], strict=True):
        apart = _shifted(gap, k)
        sides.append(jnp.where(apart, jnp.inf, rise / jnp.where(apart, 1.0, over)))
    flatter = jnp.where(jnp.abs(sides[0]) < jnp.abs(sides[1]), sides[0], sides[1])
    flatter = jnp.where(jnp.isfinite(flatter), flatter, 0.0)
    agree &= ~(_shifted(gap, -2) | _shifted(gap, -1) | _shifted(gap, 0) | _shifted(gap, 1))
    return jnp.where(stray, _shifted(y) + value, _shifted(y)), jnp.where(agree, slope, flatter)


def _gaps(x: Array, own: Array) -> Bool[Array, "profiles rows"]:
    """Rows that a gap parts from the next one."""
    return (_shifted(own, 1) <= 0) | (_shifted(x, 1) - _shifted(x) > _GAP)


def _near(x: Array) -> Int[Array, "profiles rows"]:
    """Rows before and behind each that lie within the reach of a window."""
    found = [jnp.zeros(_shifted(x).shape, jnp.int32) for _ in range(2)]
    for k in range(1, REACH + 1):
        for side, sign in enumerate((-1, 1)):
            found[side] += (jnp.abs(_shifted(x, sign * k) - _shifted(x)) <= REACH).astype(jnp.int32)
    return _word(*found)


def _ends(gap: Array, near: Array, doubt: Array) -> Int[Array, "profiles rows"]:
    """Rows before and behind each that a window can have, and whether an edge parts it from the next one."""
    edge = gap | (doubt > _EDGE)
    left, right = _sides(near)
    for k in reversed(range(REACH)):
        left = jnp.where(_shifted(edge, -k - 1), jnp.minimum(left, k), left)
        right = jnp.where(_shifted(edge, k), jnp.minimum(right, k), right)
    return _word(left, right) | _shifted(edge).astype(jnp.int32) << 16


def _word(left: Array, right: Array) -> Array:
    """Rows on either side."""
    return left << 8 | right


def _sides(word: Array) -> tuple[Array, Array]:
    return (word >> 8) & 255, word & 255


def _neighbours(rows: _Rows, low: Array, high: Array, reach: tuple[int, int]) -> Iterable[tuple[Array, Array, Array]]:
    """Weight, line and centre of each row in a window, in the form that `_added` takes.

    Args:
        rows: All of them.
        low: Rows from the first of the window to the row itself; negative where it begins behind it.
        high: Rows from the row itself to the last of the window; negative where it ends before it.
        reach: The most that `low` and `high` can be.
    """
    for k in range(-reach[0], reach[1] + 1):
        inside = -k <= low if k < 0 else k <= high
        w = jnp.where(inside, _shifted(rows.weight, k), 0.0)
        d = _shifted(rows.x, k) - _shifted(rows.x)
        yield w, d, _shifted(rows.y, k) - rows.ground - rows.slope * d


def _added(neighbours: Iterable[tuple[Array, Array, Array]]) -> _Sums:
    total: list[Array] = []
    for w, d, v in neighbours:
        wd, wv = w * d, w * v
        wdd, wdv = wd * d, wv * d
        wddd = wdd * d
        more = [w, wd, wdd, wddd, wddd * d, wv, wdv, wdv * d, wv * v, (w > 0).astype(w.dtype)]
        total = [a + b for a, b in zip(total, more, strict=True)] if total else more
    return _Sums(tuple(total[:5]), tuple(total[5:8]), *total[8:])


def _edge_heights(tables: Tables, rows: _Rows, ends: Array, size: Array) -> Array:
    """Chi-squared by which straight lines on both sides of a place behind each row are better than one parabola."""
    left, right = _sides(_shifted(ends))[0], _sides(_shifted(ends, 1))[1]
    here = jnp.zeros_like(left)
    sides = (
        _added(_neighbours(rows, jnp.minimum(left, size - 1), here, (SIZES[-1] - 1, 0))),
        _added(_neighbours(rows, here - 1, jnp.minimum(right, size - 1) + 1, (-1, SIZES[-1]))),
    )
    both = jax.tree.map(jnp.add, *sides)
    one, other = (_solved(side, 2) for side in sides)
    curved = _solved(both, 3, 0.25 * (_shifted(rows.weight) + _shifted(rows.weight, 1)) * STRAIGHT)
    free = _shifted(ends) >> 16 == 0
    better = one.explained + other.explained - curved.explained
    side = SIZES[-1] + 1
    places = (jnp.minimum(left, size - 1) + 1) * side + jnp.minimum(right, size - 1) + 1
    better = better / rows.looked_up(tables, tables.edges, places)
    return jnp.where(one.known & other.known & curved.known & free, better, 0.0)


def _doubts(doubt: Array, height: Array, size: Array) -> Array:
    """Chi-squared of the places that may be edges, with those of a size; from `_EDGE` on they are."""
    beside = [jnp.where(abs(k) < size, _shifted(height, k), 0.0) for k in range(1 - SIZES[-1], SIZES[-1])]
    own, before = _shifted(height), _shifted(doubt)
    marked = (own > _DOUBT) & (own >= functools.reduce(jnp.maximum, beside))
    return jnp.where(marked, jnp.maximum(before, own), before)


def _most_doubtful(doubt: Array, window: Array) -> tuple[Array, Array]:
    """The most doubtful edge in the window of each row, and how many rows on the row before it is."""
    low, high = _sides(window)
    most, at = jnp.zeros(low.shape, doubt.dtype), jnp.full(low.shape, REACH, jnp.int32)
    for k in range(-REACH, REACH):
        there = jnp.where((k >= -low) & (k < high), _shifted(doubt, k), 0.0)
        at, most = jnp.where(there > most, k, at), jnp.maximum(there, most)
    return most, at


def _cut_short(ends: Array, most: Array, at: Array) -> Array:
    """The ends of windows that the most doubtful edge in them ends."""
    left, right = _sides(ends)
    return _word(jnp.where((most > 0) & (at < 0), -at - 1, left), jnp.where((most > 0) & (at >= 0), at, right))


def _windows(tables: Tables, rows: _Rows, ends: Array) -> tuple[Array, ...]:
    """For every row a parabola in the largest window that it fits and whose value agrees with those of smaller ones.

    Returns:
        Centre minus that of the row, its variance, that of the window's lines over their number, the rows of the window
        on either side in one word, and the variance that the centre had were rows independent.
    """
    left, right = _sides(ends)
    weight, many = _shifted(rows.weight), rows.looked_up(tables, tables.rows, 0)[..., 2]
    alone = 1.0 / jnp.where(weight > 0, weight, 1.0)
    state: tuple[Array, ...] = jnp.zeros_like(alone), alone, many * alone, jnp.zeros_like(ends), alone
    goes_on = jnp.ones(alone.shape, jnp.bool_)
    place = left * (REACH + 1) + right
    for number, size in enumerate(SIZES):
        low, high = window_of(left, right, size)
        sums = _added(_neighbours(rows, low, high, (2 * size, 2 * size)))
        found, own, chi2 = _parabola(sums)
        value, variance, _, window, before = state
        inflation, share, scatter, apart = jnp.moveaxis(rows.looked_up(tables, tables.windows[number], place), -1, 0)
        told = (sums.rows >= 5.0) & (own >= 0)
        free = jnp.where(told, sums.rows - 3.0, 2.0)
        freedom, single = share * free, window == 0
        most, far = jnp.where(single, _MISFIT[0], _MISFIT[1]), jnp.where(single, _APART[0], _APART[1])
        fits_it = chi2 <= freedom + most * scatter * jnp.sqrt(2.0 * free)
        fits_it &= jnp.abs(found - value) <= far * jnp.sqrt(apart * jnp.maximum(before - own, 0.0))
        # Residuals of the parabola beyond the noise count as noise of independent rows.
        excess = jnp.maximum(chi2 - freedom, 0.0) / free
        here = (inflation + excess) * own
        better = goes_on & told & fits_it & (here < variance)
        total = jnp.where(sums.s[0] > 0, sums.s[0], 1.0)
        new = found, here, (many + excess) / total, _word(low, high), (1.0 + excess) * own
        state = tuple(jnp.where(better, a, b) for a, b in zip(new, state, strict=True))
        goes_on &= fits_it | ~told
    return state


def _lengths(x: Array, window: Array) -> Array:
    """Lines from the first to the last row of each window."""
    row = jnp.arange(window.shape[1], dtype=jnp.int32)[None] + _MARGIN
    low, high = _sides(window)
    return jnp.take_along_axis(x, row + high, 1) - jnp.take_along_axis(x, row - low, 1) + 1.0


def _mixed(rows: _Rows, found: tuple[Array, Array], shared: Array, most: Array) -> tuple[Array, Array, Array]:
    """Where an edge is in doubt, the answers with and without it count by their odds."""
    (value, other), (variance, other_variance) = found
    share = jnp.where(most > 0, 1.0 / (1.0 + jnp.exp(0.5 * (_EVEN - most))), 0.0)
    apart = other - value
    value, variance = value + share * apart, variance + share * (other_variance - variance + (1.0 - share) * apart**2)
    own, used = _shifted(rows.own), _shifted(rows.weight) > 0
    alone = 1.0 / jnp.where(own > 0, own, 1.0)
    # So an average of smoothed centres is stated as good as that of the rows.
    best = jnp.where(used, jnp.minimum(variance, alone), alone)
    lines = jnp.where(used, jnp.maximum(shared / best, 1.0), 1.0)
    return _shifted(rows.y) + jnp.where(used, value, 0.0), jnp.sqrt(best), lines


class _Solved(NamedTuple):
    """Normal equations of a polynomial about the row, by elimination: what is added up has one sign, so that single
    precision is enough."""

    pivots: list[Array]
    """Information of each coefficient with those before it unknown."""
    rest: list[Array]
    """The right sides after elimination."""
    lower: list[list[Array]]
    """Factors of elimination; `lower[i][j]` takes coefficient j out of equation i."""
    known: Bool[Array, "profiles rows"]
    """Whether all coefficients are determined."""

    @property
    def explained(self) -> Array:
        """Part of the square sum that the polynomial explains."""
        return functools.reduce(operator.add, (r * r / p for r, p in zip(self.rest, self.pivots, strict=True)))


def _solved(sums: _Sums, size: int, straight: Array | float = 0.0) -> _Solved:
    """Eliminate the coefficients of a line (2) or a parabola (3), of whose curvature a prior has some information."""
    diagonal = sums.s[0], sums.s[2], sums.s[4] + straight
    pivots: list[Array] = []
    rest: list[Array] = []
    lower: list[list[Array]] = []
    known = sums.rows >= size
    for i in range(size):
        pivot, right, factors = diagonal[i], sums.t[i], list[Array]()
        for j in range(i):
            entry = sums.s[i + j]
            for k in range(j):
                entry = entry - factors[k] * lower[j][k] * pivots[k]
            factors.append(entry / pivots[j])
            pivot, right = pivot - factors[j] * entry, right - factors[j] * rest[j]
        determined = pivot > _SINGULAR * diagonal[i]
        known &= determined
        pivots.append(jnp.where(determined, pivot, 1.0))
        rest.append(right)
        lower.append(factors)
    return _Solved(pivots, rest, lower, known)


def _parabola(sums: _Sums) -> tuple[Array, Array, Array]:
    """Value of a parabola at 0, the value's variance (-1 without a parabola), and chi-squared."""
    solved = _solved(sums, 3)
    (p0, p1, p2), (r0, r1, r2) = solved.pivots, solved.rest
    _, (l10,), (l20, l21) = solved.lower
    # What each pivot's equation adds to the value at 0.
    by_1, by_2 = -l10, l10 * l21 - l20
    value = r0 / p0 + by_1 * (r1 / p1) + by_2 * (r2 / p2)
    variance = 1.0 / p0 + by_1 * by_1 / p1 + by_2 * by_2 / p2
    return value, jnp.where(solved.known, variance, -1.0), sums.q - solved.explained
