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

All windows are sums of moments between two rows. They are differences of running sums over blocks of rows, in double
precision about each block's middle, so that no window costs more than a small one and faint rows lose no digits beside
bright ones.

Source: A. Savitzky, M. J. E. Golay, Smoothing and differentiation of data by simplified least squares procedures,
Anal. Chem. 36, 1964; windows of their own for every point: V. Katkovnik, A new method for varying adaptive bandwidth
selection, IEEE Trans. Signal Processing 47, 1999.
"""

import functools
import operator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import Array
from jaxscan.stripes.frames import Sites


_SIZES = (3, 6, 10)
"""Half sizes of windows, and lines on either side of a possible edge: of fewer lines more noise would be left, of more
the surface itself would be smoothed."""
_REACH = 20
"""Rows and lines that a window reaches to one side at most."""
_GAP = 4.0
"""Largest distance of neighbouring lines on one surface."""
_STRAIGHT = 4500.0
"""How well it is known that surfaces are straight: information of a prior of the curvature, in that of two rows;
corners of a few standard deviations a line are still seen, and spheres are not cut into pieces."""
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
_PROFILES, _FEW = 32, 8
"""Profiles that are smoothed at a time, and where there are only a few."""
_BLOCK, _MARGIN = 64, 24
"""Rows of a block of running sums, and those beside it that its windows reach."""
_EVERY_LINE = Sites()


class Smoothed(NamedTuple):
    """Centres [profiles, lines] that use their neighbours; zero where there is no stripe."""

    u: Float[np.ndarray, "profiles lines"]
    """Stripe centre [px]."""
    sigma: Float[np.ndarray, "profiles lines"]
    """Its standard deviation [px]."""
    shared_lines: Float[np.ndarray, "profiles lines"]
    """Lines over which the noise of the centre is shared: its correlation with the k-th next line of the profile is
    about 1 - k / shared_lines; 1 where the row is by itself."""


def smooth_profiles(
    u: Float[np.ndarray, "profiles lines"],
    sigma: Float[np.ndarray, "profiles lines"],
    valid: Bool[np.ndarray, "profiles lines"],
    sites: Sites = _EVERY_LINE,
) -> Smoothed:
    """Centres that use their neighbours along the stripe, and none across an edge.

    A profile depends on no other one. The mean of many smoothed centres is no better than that of the rows they were
    made of: compute with the sigmas of the rows, or with `shared_lines`.

    Args:
        u: Stripe centres of the rows [px].
        sigma: Their standard deviations [px].
        valid: Which of them exist.
        sites: Where the laser's colour is seen: a mosaic has it on every second line only.
    """
    lines = np.s_[:, sites.first_line :: sites.line_step]
    whole = [np.asarray(field) for field in (u, sigma, valid)]
    fields = [field[lines] for field in whole]
    found = [np.zeros(fields[0].shape, np.float32) for _ in Smoothed._fields]
    with jax.enable_x64(True):
        for first in range(0, len(fields[0]) if fields[0].size else 0, _PROFILES):
            part = [field[first : first + _PROFILES] for field in fields]
            count = len(part[0])
            # Few sizes, so that little is compiled.
            room = _PROFILES if len(fields[0]) > _FEW else _FEW if count > 1 else 1
            part = [np.pad(field, ((0, max(room - count, 0)), (0, 0))) for field in part]
            for to, field in zip(found, _smoothed(*part), strict=True):
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


class _Running(NamedTuple):
    """Sums of moments up to each row of a block, about the block's middle."""

    sums: Float[Array, "10 sums"]
    """Weights times the line to the power of 0 to 4, times the centre and the line to the power of 0 to 2, times the
    square of the centre; and rows. Of all blocks, one more than a block and its margins have rows."""
    x: Float[Array, "profiles rows"]
    """Lines about the middle of the row's block."""
    y: Float[Array, "profiles rows"]
    """Centres about one of the row's block [px]."""
    at: Int[Array, "profiles rows"]
    """Where in `sums` those up to before each row are."""


def _smoothed(u: Array, sigma: Array, valid: Array) -> tuple[Array, Array, Array]:
    """Of the profiles of one laser, as `Smoothed`.

    Each step is compiled by itself, so that what it gives is kept: inside of one function XLA's code for a CPU would
    compute it again for each neighbour that looks at it.
    """
    rows, number = _gathered(u, sigma, valid)
    running = _summed(rows)
    edge, doubt = _gaps(rows)
    for size in _SIZES:
        left, right = _ends(rows, edge)
        height = _compared(rows, running, edge, left, right, size)
        edge, doubt = _marked(height, edge, doubt, size)
    ends = _ends(rows, edge)
    first = _windows(rows, running, ends)
    most, at = _most_doubtful(doubt, first[3], first[4])
    # The same with windows that end at the most doubtful edge in them.
    other = _windows(rows, running, _cut_short(ends, most, at))
    return _mixed(rows, first, other, most, number, valid)


@jax.jit
def _gathered(u: Array, sigma: Array, valid: Array) -> tuple[_Rows, Int[Array, "profiles lines"]]:
    """The valid rows of every profile, and which of them each line is."""
    profiles, lines = u.shape
    number = jnp.where(valid, jnp.cumsum(valid, 1, dtype=jnp.int32) - 1, lines)
    profile = jnp.arange(profiles, dtype=jnp.int32)[:, None]
    line = jnp.zeros((profiles, lines), jnp.int32)
    line = line.at[profile, number].set(jnp.arange(lines, dtype=jnp.int32)[None], mode="drop")
    real = jnp.arange(lines, dtype=jnp.int32)[None] < jnp.sum(valid, 1, dtype=jnp.int32)[:, None]

    def packed(field: Array) -> Array:
        return jnp.take_along_axis(field.astype(jnp.float64), line, 1)

    own = jnp.where(real, 1.0 / jnp.maximum(packed(sigma), _LEAST_PX) ** 2, 0.0)
    rows = _Rows(jnp.where(real, line, lines + 100).astype(jnp.float64), jnp.where(real, packed(u), 0.0), own, own)
    return rows._replace(weight=jnp.where(_strays(rows), 0.0, own)), number


def _shifted(field: Array, by: int) -> Array:
    """The value so many rows further on; 0 beyond the profile."""
    if by == 0:
        return field
    rows = field.shape[1]
    part = field[:, by:] if by > 0 else field[:, : max(rows + by, 0)]
    return jnp.pad(part, ((0, 0), (min(max(-by, 0), rows), min(max(by, 0), rows))))


def _strays(rows: _Rows) -> Bool[Array, "profiles rows"]:
    """Centres that lie off a straight line on which two neighbours on either side agree."""
    away = (-2, -1, 1, 2)
    d = [_shifted(rows.x, k) - rows.x for k in away]
    v = [_shifted(rows.y, k) - rows.y for k in away]
    w = [_shifted(rows.own, k) for k in away]

    def total(*factors: list[Array]) -> Array:
        products = [functools.reduce(operator.mul, each) for each in zip(*factors, strict=True)]
        return functools.reduce(operator.add, products)

    s0, s1, s2 = total(w), total(w, d), total(w, d, d)
    t0, t1, q = total(w, v), total(w, d, v), total(w, v, v)
    value, slope, variance = _line(s0, s1, s2, t0, t1)
    # Four of them, none beyond the ends, and near.
    whole = (w[0] * w[1] * w[2] * w[3] > 0) & (d[3] - d[0] <= 4.0 + _GAP) & (variance > 0)
    off = value * value > _STRAY**2 * (variance + 1.0 / jnp.where(rows.own > 0, rows.own, 1.0))
    return whole & (q - value * t0 - slope * t1 < _AGREE) & off


@jax.jit
def _summed(rows: _Rows) -> _Running:
    profiles, count = rows.x.shape
    blocks, width = -(-count // _BLOCK), _BLOCK + 2 * _MARGIN
    room = blocks * _BLOCK - count

    def cut(field: Array) -> Array:
        """[rows of a block, profiles, blocks]: sums go on along the leading axis, one addition for all blocks."""
        wide = jnp.pad(field, ((0, 0), (_MARGIN, _MARGIN + room)))
        return jnp.stack([wide[:, k * _BLOCK : k * _BLOCK + width] for k in range(blocks)], 2).swapaxes(0, 1)

    x, y, w = cut(rows.x), cut(rows.y), cut(rows.weight)
    x0, y0 = x[width // 2], y[width // 2]
    # Beyond a gap nothing belongs to a window: there any number will do that costs no digits.
    x = jnp.clip(x - x0[None], -2.0 * width, 2.0 * width)
    y = y - y0[None]

    def add(total: tuple[Array, ...], row: tuple[Array, Array, Array]) -> tuple:
        x, y, w = row
        y = jnp.where(w > 0, y, 0.0)
        wx, wy = w * x, w * y
        wxx = wx * x
        more = w, wx, wxx, wxx * x, wxx * x * x, wy, wx * y, wxx * y, wy * y, (w > 0).astype(w.dtype)
        return tuple(a + b for a, b in zip(total, more, strict=True)), total

    nothing = tuple(jnp.zeros(x0.shape, x.dtype) for _ in range(10))
    last: tuple[Array, ...]
    before: tuple[Array, ...]
    last, before = lax.scan(add, nothing, (x, y, w))
    sums = jnp.stack([jnp.concatenate([b, a[None]]).reshape(-1) for b, a in zip(before, last, strict=True)])
    block, row = np.divmod(np.arange(count), _BLOCK)
    at = ((_MARGIN + row) * profiles + np.arange(profiles)[:, None]) * blocks + block

    def own(field: Array) -> Array:
        inner = field[_MARGIN : _MARGIN + _BLOCK]
        return jnp.transpose(inner, (1, 2, 0)).reshape(profiles, -1)[:, :count]

    return _Running(sums, own(x), own(y), jnp.asarray(at.astype(np.int32)))


@jax.jit
def _between(running: _Running, first: Array, last: Array) -> list[Array]:
    """The sums from the `first`-th row before each to the `last`-th behind it, about the row's own line and centre.

    About the block's middle a window far from it would be an ill-conditioned parabola of large numbers.
    """
    step = running.sums.shape[1] // (_BLOCK + 2 * _MARGIN + 1)
    high, low = running.at + step * (last + 1), running.at - step * first
    m = [s.at[high].get(mode="promise_in_bounds") - s.at[low].get(mode="promise_in_bounds") for s in running.sums]
    s0, m1, m2, m3, m4, n0, n1, n2, q, rows = m
    x, y = running.x, running.y
    s1, s2 = m1 - x * s0, m2 - x * (2 * m1 - x * s0)
    s3 = m3 - x * (3 * m2 - x * (3 * m1 - x * s0))
    s4 = m4 - x * (4 * m3 - x * (6 * m2 - x * (4 * m1 - x * s0)))
    t1, t2 = n1 - x * n0 - y * s1, n2 - x * (2 * n1 - x * n0) - y * s2
    return [s0, s1, s2, s3, s4, n0 - y * s0, t1, t2, q - y * (2 * n0 - y * s0), rows]


@jax.jit
def _gaps(rows: _Rows) -> tuple[Bool[Array, "profiles rows"], Float[Array, "profiles rows"]]:
    """Rows that a gap parts from the next one; and doubts about the others, none as yet."""
    following = _shifted(rows.own, 1) > 0
    return ~following | (_shifted(rows.x, 1) - rows.x > _GAP), jnp.zeros(rows.y.shape, jnp.float32)


@jax.jit
def _ends(rows: _Rows, edge: Bool[Array, "profiles rows"]) -> tuple[Array, Array]:
    """Rows before and behind each that no edge parts from it and that are not farther away than a window reaches."""
    free, x = ~edge, rows.x.astype(jnp.int32)
    left, right = jnp.zeros(edge.shape, jnp.int32), jnp.zeros(edge.shape, jnp.int32)
    goes_left, goes_right = jnp.ones(edge.shape, jnp.bool_), jnp.ones(edge.shape, jnp.bool_)
    for k in range(1, _REACH + 1):
        goes_left &= _shifted(free, -k) & (x - _shifted(x, -k) <= _REACH)
        goes_right &= _shifted(free, k - 1) & (_shifted(x, k) - x <= _REACH)
        left, right = left + goes_left.astype(jnp.int32), right + goes_right.astype(jnp.int32)
    return left, right


def _compared(rows: _Rows, running: _Running, edge: Array, left: Array, right: Array, size: Array | int) -> Array:
    """Chi-squared by which straight lines on both sides of a place behind each row are better than one parabola."""
    before, here, after, behind = _sides(left, right, size)
    return _better(rows, edge, _between(running, before, here), _between(running, after, behind))


@jax.jit
def _sides(left: Array, right: Array, size: Array | int) -> tuple[Array, Array, Array, Array]:
    """The rows before a place behind each row, and those behind it, as `_between` takes them."""
    here = jnp.zeros_like(left)
    return jnp.minimum(left, size - 1), here, here - 1, jnp.minimum(_shifted(right, 1), size - 1) + 1


@jax.jit
def _better(rows: _Rows, edge: Array, one: list[Array], other: list[Array]) -> Array:
    both = [a + b for a, b in zip(one, other, strict=True)]
    lines, known = zip(*(_line_explains(side) for side in (one, other)), strict=True)
    curved, whole = _parabola_explains(both, 0.25 * (rows.weight + _shifted(rows.weight, 1)) * _STRAIGHT)
    better = jnp.where(known[0] & known[1] & whole & ~edge, lines[0] + lines[1] - curved, 0.0)
    return better.astype(jnp.float32)


@jax.jit
def _marked(height: Array, edge: Array, doubt: Array, size: Array | int) -> tuple[Array, Array]:
    """The edges with those of a size, and the chi-squared of places that may be edges."""
    # Those beside an edge look across it.
    beside = [jnp.where(abs(k) < size, _shifted(height, k), 0.0) for k in range(1 - _SIZES[-1], _SIZES[-1])]
    marked = (height > _DOUBT) & (height >= functools.reduce(jnp.maximum, beside))
    return edge | (marked & (height > _EDGE)), jnp.where(marked, jnp.maximum(doubt, height), doubt)


@jax.jit
def _most_doubtful(doubt: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """The most doubtful edge in the window of each row, and how many rows on the row before it is."""
    most, at = jnp.zeros_like(doubt), jnp.full(doubt.shape, _REACH, jnp.int32)
    for k in range(-_REACH, _REACH):
        there = jnp.where((k >= -low) & (k < high), _shifted(doubt, k), 0.0)
        at, most = jnp.where(there > most, k, at), jnp.maximum(there, most)
    return most, at


@jax.jit
def _cut_short(ends: tuple[Array, Array], most: Array, at: Array) -> tuple[Array, Array]:
    left, right = ends
    return jnp.where((most > 0) & (at < 0), -at - 1, left), jnp.where((most > 0) & (at >= 0), at, right)


def _windows(rows: _Rows, running: _Running, ends: tuple[Array, Array]) -> tuple[Array, ...]:
    """For every row a parabola in the largest window that it fits and whose value agrees with those of smaller ones.

    Returns:
        Centre minus that of the row, its variance, that of the window's lines over their number, and the rows of the
        window on either side.
    """
    return _chosen(rows.weight, ends, [_fitted(running, ends, size) for size in _SIZES])


@jax.jit
def _reach(ends: tuple[Array, Array], size: Array | int) -> tuple[Array, Array]:
    """Rows of a window to both sides. A side that ends early is made up for on the other."""
    left, right = ends
    first = jnp.minimum(left, 2 * size - jnp.minimum(right, size))
    return first, jnp.minimum(right, 2 * size - jnp.minimum(left, size))


def _fitted(running: _Running, ends: tuple[Array, Array], size: Array | int) -> tuple[Array, ...]:
    """Value of the parabola in a window, its variance, chi-squared, sum of the weights, and rows."""
    sums = _between(running, *_reach(ends, size))
    return *_parabola(sums), sums[0], sums[9]


@jax.jit
def _chosen(weight: Array, ends: tuple[Array, Array], fits: list[tuple[Array, ...]]) -> tuple[Array, ...]:
    alone = 1.0 / jnp.where(weight > 0, weight, 1.0)
    zero = jnp.zeros(weight.shape, jnp.int32)
    state: tuple[Array, ...] = jnp.zeros_like(alone), alone, alone, zero, zero
    goes_on = jnp.ones(alone.shape, jnp.bool_)
    for size, (found, own, chi2, total, used) in zip(_SIZES, fits, strict=True):
        value, variance, _, low, high = state
        told = (used >= 5.0) & (own >= 0)
        freedom = jnp.where(told, used - 3.0, 2.0)
        single = (low == 0) & (high == 0)
        most, far = jnp.where(single, _MISFIT[0], _MISFIT[1]), jnp.where(single, _APART[0], _APART[1])
        fits_it = chi2 <= freedom + most * jnp.sqrt(2.0 * freedom)
        fits_it &= jnp.abs(found - value) <= far * jnp.sqrt(jnp.maximum(variance - own, 0.0))
        # Residuals of the parabola beyond the noise count as noise.
        excess = jnp.maximum(chi2 / freedom, 1.0)
        better = goes_on & told & fits_it & (excess * own < variance)
        new = found, excess * own, excess / jnp.where(total > 0, total, 1.0), *_reach(ends, size)
        state = tuple(jnp.where(better, a, b) for a, b in zip(new, state, strict=True))
        goes_on &= fits_it | ~told
    return state


@jax.jit
def _mixed(
    rows: _Rows, first: tuple[Array, ...], other: tuple[Array, ...], most: Array, number: Array, valid: Array
) -> tuple[Array, Array, Array]:
    """On the lines of the profiles: where an edge is in doubt, the answers with and without it count by their odds."""
    value, variance, spread, low, high = first
    count = rows.x.shape[1]
    row = jnp.arange(count, dtype=jnp.int32)[None]
    line = lambda at: jnp.take_along_axis(rows.x, jnp.clip(at, 0, count - 1), 1)
    shared = spread * (line(row + high) - line(row - low) + 1.0)
    share = jnp.where(most > 0, 1.0 / (1.0 + jnp.exp(0.5 * (_EVEN - most))), 0.0).astype(value.dtype)
    apart = other[0] - value
    value, variance = value + share * apart, variance + share * (other[1] - variance + (1.0 - share) * apart**2)
    alone = 1.0 / jnp.where(rows.own > 0, rows.own, 1.0)
    used = rows.weight > 0
    # So an average of smoothed centres is stated as good as that of the rows.
    best = jnp.where(used, jnp.minimum(variance, alone), alone)
    share = jnp.where(used, jnp.maximum(shared / best, 1.0), 1.0)
    found = rows.y + jnp.where(used, value, 0.0), jnp.sqrt(best), share
    back = jnp.minimum(number, count - 1)
    spread_out = lambda field: jnp.where(valid, jnp.take_along_axis(field, back, 1), 0.0).astype(jnp.float32)
    return spread_out(found[0]), spread_out(found[1]), spread_out(found[2])


def _line(s0: Array, s1: Array, s2: Array, t0: Array, t1: Array) -> tuple[Array, Array, Array]:
    """Of a weighted straight line at 0: value, slope, variance; no variance (-1) without a line."""
    det = s0 * s2 - s1 * s1
    known = det > 1e-9 * s0 * s2
    part = 1.0 / jnp.where(known, det, 1.0)
    value, slope = (s2 * t0 - s1 * t1) * part, (s0 * t1 - s1 * t0) * part
    return value, slope, jnp.where(known, s2 * part, -1.0)


def _line_explains(sums: list[Array]) -> tuple[Array, Array]:
    """Part of the square sum that a straight line explains, and whether there is one."""
    s0, s1, s2, t0, t1 = sums[0], sums[1], sums[2], sums[5], sums[6]
    det = s0 * s2 - s1 * s1
    # The number of rows has no rounding error, a determinant of one row has.
    known = (det > 1e-9 * s0 * s2) & (sums[9] >= 2.0)
    return (s2 * t0 * t0 - 2.0 * s1 * t0 * t1 + s0 * t1 * t1) / jnp.where(known, det, 1.0), known


def _cofactors(s0: Array, s1: Array, s2: Array, s3: Array, s4: Array) -> tuple[tuple[Array, ...], Array, Array]:
    """Of the normal matrix of a parabola: its inverse (00, 01, 02, 11, 12, 22) times the determinant, one over that,
    and whether it has one."""
    c00, c01, c02 = s2 * s4 - s3 * s3, s2 * s3 - s1 * s4, s1 * s3 - s2 * s2
    det = s0 * c00 + s1 * c01 + s2 * c02
    known = det > 1e-9 * s0 * s2 * s4
    rest = s0 * s4 - s2 * s2, s1 * s2 - s0 * s3, s0 * s2 - s1 * s1
    return (c00, c01, c02, *rest), 1.0 / jnp.where(known, det, 1.0), known


def _parabola_explains(sums: list[Array], straight: Array) -> tuple[Array, Array]:
    """Part of the square sum that a parabola explains, of whose curvature a prior has some information."""
    s0, s1, s2, s3, s4, t0, t1, t2 = sums[:8]
    (c00, c01, c02, c11, c12, c22), part, known = _cofactors(s0, s1, s2, s3, s4 + straight)
    square = c00 * t0 * t0 + c11 * t1 * t1 + c22 * t2 * t2
    return (square + 2.0 * (c01 * t0 * t1 + c02 * t0 * t2 + c12 * t1 * t2)) * part, known


@jax.jit
def _parabola(sums: list[Array]) -> tuple[Array, Array, Array]:
    """Value of a parabola at 0, the value's variance (-1 without a parabola), and chi-squared."""
    s0, s1, s2, s3, s4, t0, t1, t2 = sums[:8]
    (c00, c01, c02, c11, c12, c22), part, known = _cofactors(s0, s1, s2, s3, s4)
    a0, a1, a2 = c00 * t0 + c01 * t1 + c02 * t2, c01 * t0 + c11 * t1 + c12 * t2, c02 * t0 + c12 * t1 + c22 * t2
    chi2 = sums[8] - (a0 * t0 + a1 * t1 + a2 * t2) * part
    return a0 * part, jnp.where(known, c00 * part, -1.0), chi2
