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
from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import Array
from jaxscan.stripes.frames import Sites
from jaxscan.stripes.packing import packed


_SIZES = np.array([3, 6, 10])
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
_TOGETHER = 1024
"""Rows in doubt that are looked at together."""
_BLOCK, _MARGIN = 64, 24
"""Rows of a block of running sums, and those beside it that its windows reach."""
_EVERY_LINE = Sites()

T = TypeVar("T")


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
    with jax.enable_x64(True):
        found = [np.asarray(field, np.float32) for field in _smoothed(*(field[lines] for field in whole))]
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


@jax.jit
def _smoothed(u: Array, sigma: Array, valid: Array) -> tuple[Array, Array, Array]:
    """Of the profiles of one laser, as `Smoothed`."""
    profiles, lines = u.shape
    number = jnp.where(valid, jnp.cumsum(valid, 1, dtype=jnp.int32) - 1, lines)
    profile = jnp.arange(profiles, dtype=jnp.int32)[:, None]
    line = jnp.zeros((profiles, lines), jnp.int32)
    line = line.at[profile, number].set(jnp.arange(lines, dtype=jnp.int32)[None], mode="drop")
    real = jnp.arange(lines)[None] <= jnp.max(jnp.where(valid, number, -1), 1, keepdims=True)

    def packed(field: Array) -> Array:
        return jnp.take_along_axis(field.astype(jnp.float64), line, 1)

    own = jnp.where(real, 1.0 / jnp.maximum(packed(sigma), _LEAST_PX) ** 2, 0.0)
    some = jnp.any(valid)
    rows = _Rows(jnp.where(real, line, lines + 100).astype(jnp.float64), jnp.where(real, packed(u), 0.0), own, own)
    rows = rows._replace(weight=_kept(some, lambda: jnp.where(_strays(rows), 0.0, own)))
    running = _kept(some, lambda: _Running.of(rows))
    edge, doubt = _edges(rows, running, some)
    centre, variance, shared = _parabolas(rows, running, edge, doubt, some)
    alone = 1.0 / jnp.where(real, own, 1.0)
    used = rows.weight > 0
    # So an average of smoothed centres is stated as good as that of the rows.
    best = jnp.where(used, jnp.minimum(variance, alone), alone)
    share = jnp.where(used, jnp.maximum(shared / best, 1.0), 1.0)
    found = rows.y + jnp.where(used, centre, 0.0), jnp.sqrt(best), share
    back = jnp.minimum(number, lines - 1)
    spread = lambda field: jnp.where(valid, jnp.take_along_axis(field, back, 1), 0.0).astype(jnp.float32)
    return spread(found[0]), spread(found[1]), spread(found[2])


def _kept(some: Bool[Array, ""], make: Callable[[], T]) -> T:
    """What a function gives, written to memory because it comes out of a branch. XLA's code for a CPU would compute it
    again for each use, and for each neighbour that looks at it."""
    return lax.cond(some, make, lambda: jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(make)))


def _shifted(field: Array, by: int) -> Array:
    """The value so many rows further on; 0 beyond the profile."""
    if by == 0:
        return field
    rows = field.shape[1]
    part = field[:, by:] if by > 0 else field[:, : rows + by]
    return jnp.pad(part, ((0, 0), (max(-by, 0), max(by, 0))))


def _strays(rows: _Rows) -> Bool[Array, "profiles rows"]:
    """Centres that lie off a straight line on which two neighbours on either side agree."""
    away = (-2, -1, 1, 2)
    d = [_shifted(rows.x, k) - rows.x for k in away]
    v = [_shifted(rows.y, k) - rows.y for k in away]
    w = [_shifted(rows.own, k) for k in away]
    total = lambda *factors: sum(functools.reduce(operator.mul, each) for each in zip(*factors, strict=True))
    s0, s1, s2 = sum(w), total(w, d), total(w, d, d)
    t0, t1, q = total(w, v), total(w, d, v), total(w, v, v)
    value, slope, variance = _line(s0, s1, s2, t0, t1)
    # Four of them, none beyond the ends, and near.
    whole = (w[0] * w[1] * w[2] * w[3] > 0) & (d[3] - d[0] <= 4.0 + _GAP) & (variance > 0)
    off = value * value > _STRAY**2 * (variance + 1.0 / jnp.where(rows.own > 0, rows.own, 1.0))
    return whole & (q - value * t0 - slope * t1 < _AGREE) & off


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

    @classmethod
    def of(cls, rows: _Rows) -> "_Running":
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
        x = jnp.clip(x - x0, -2.0 * width, 2.0 * width)
        y = jnp.where(w > 0, y - y0, 0.0)

        def add(total: tuple[Array, ...], row: tuple[Array, Array, Array]) -> tuple:
            x, y, w = row
            wx, wy = w * x, w * y
            wxx = wx * x
            more = w, wx, wxx, wxx * x, wxx * x * x, wy, wx * y, wxx * y, wy * y, (w > 0).astype(w.dtype)
            return tuple(a + b for a, b in zip(total, more, strict=True)), total

        nothing = (jnp.zeros(x0.shape, x.dtype),) * 10
        last, before = lax.scan(add, nothing, (x, y, w))
        sums = jnp.stack([jnp.concatenate([b, a[None]]).reshape(-1) for b, a in zip(before, last, strict=True)])
        block, row = np.divmod(np.arange(count), _BLOCK)
        at = ((_MARGIN + row) * profiles + np.arange(profiles)[:, None]) * blocks + block

        def own(field: Array) -> Array:
            inner = field[_MARGIN : _MARGIN + _BLOCK]
            return jnp.transpose(inner, (1, 2, 0)).reshape(profiles, -1)[:, :count]

        return cls(sums, own(x), own(jnp.broadcast_to(cut(rows.y) - y0, x.shape)), jnp.asarray(at.astype(np.int32)))

    def windows(self, first: Array, last: Array) -> list[Array]:
        """The sums from the `first`-th row before each to the `last`-th behind it, about the row's own line and centre.

        About the block's middle a window far from it would be an ill-conditioned parabola of large numbers.
        """
        step = self.sums.shape[1] // (_BLOCK + 2 * _MARGIN + 1)
        high, low = self.at + step * (last + 1), self.at - step * first
        m = [s.at[high].get(mode="promise_in_bounds") - s.at[low].get(mode="promise_in_bounds") for s in self.sums]
        s0, m1, m2, m3, m4, n0, n1, n2, q, rows = m
        x, y = self.x, self.y
        s1, s2 = m1 - x * s0, m2 - x * (2 * m1 - x * s0)
        s3 = m3 - x * (3 * m2 - x * (3 * m1 - x * s0))
        s4 = m4 - x * (4 * m3 - x * (6 * m2 - x * (4 * m1 - x * s0)))
        t1, t2 = n1 - x * n0 - y * s1, n2 - x * (2 * n1 - x * n0) - y * s2
        return [s0, s1, s2, s3, s4, n0 - y * s0, t1, t2, q - y * (2 * n0 - y * s0), rows]


def _edges(
    rows: _Rows, running: _Running, some: Bool[Array, ""]
) -> tuple[Bool[Array, "profiles rows"], Float[Array, "profiles rows"]]:
    """Whether each row and the next are on two surfaces, first by few rows, then by more that end at known edges; and
    the chi-squared of places that may be edges, and are none for certain."""
    following = _shifted(rows.own, 1) > 0
    straight = 0.25 * (rows.weight + _shifted(rows.weight, 1)) * _STRAIGHT
    edge = _kept(some, lambda: ~following | (_shifted(rows.x, 1) - rows.x > _GAP))

    def look(state: tuple[Array, Array], size: Array) -> tuple[tuple[Array, Array], None]:
        edge, doubt = state
        most = int(_SIZES[-1])

        def compared() -> Array:
            before, behind = _kept(some, lambda: (_runs(edge, most - 1), _shifted(_runs_on(edge, most - 1), 1)))
            before, behind = jnp.minimum(before, size - 1), jnp.minimum(behind, size - 1)
            one = running.windows(before, jnp.zeros_like(before))
            other = running.windows(-jnp.ones_like(before), behind + 1)
            both = [a + b for a, b in zip(one, other, strict=True)]
            lines, known = zip(*(_line_explains(side) for side in (one, other)), strict=True)
            curved, whole = _parabola_explains(both, straight)
            return jnp.where(known[0] & known[1] & whole & ~edge, lines[0] + lines[1] - curved, 0.0)

        height = _kept(some, compared)
        # Those beside an edge look across it.
        highest = height
        for k in range(1, most):
            beside = jnp.maximum(_shifted(height, k), _shifted(height, -k))
            highest = jnp.where(k < size, jnp.maximum(highest, beside), highest)
        marked = (height > _DOUBT) & (height >= highest)
        return (edge | (marked & (height > _EDGE)), jnp.where(marked, jnp.maximum(doubt, height), doubt)), None

    (edge, doubt), _ = lax.scan(look, (edge, jnp.zeros_like(rows.y)), jnp.asarray(_SIZES, jnp.int32))
    return edge, doubt


def _runs(edge: Bool[Array, "profiles rows"], most: int) -> Int[Array, "profiles rows"]:
    """Rows before each, `most` at most, that no edge parts from it."""
    rows, goes_on = jnp.zeros(edge.shape, jnp.int32), jnp.ones(edge.shape, jnp.bool_)
    free = ~edge
    for k in range(1, most + 1):
        goes_on &= _shifted(free, -k)
        rows += goes_on
    return rows


def _runs_on(edge: Bool[Array, "profiles rows"], most: int) -> Int[Array, "profiles rows"]:
    """Rows behind each, `most` at most, that no edge parts from it."""
    rows, goes_on = jnp.zeros(edge.shape, jnp.int32), jnp.ones(edge.shape, jnp.bool_)
    free = ~edge
    for k in range(most):
        goes_on &= _shifted(free, k)
        rows += goes_on
    return rows


def _parabolas(
    rows: _Rows, running: _Running, edge: Array, doubt: Array, some: Bool[Array, ""]
) -> tuple[Array, Array, Array]:
    """Centre minus that of the row, its variance, and its shared lines times that variance, of every row.

    Windows end at edges; where an edge is in doubt, the answers with and without it count by their odds.
    """

    def sides() -> tuple[Array, Array]:
        left, right = _runs(edge, _REACH), _runs_on(edge, _REACH)
        # No window is longer than so many lines.
        for k in range(_REACH, 0, -1):
            left = jnp.where((left == k) & (rows.x - _shifted(rows.x, -k) > _REACH), k - 1, left)
            right = jnp.where((right == k) & (_shifted(rows.x, k) - rows.x > _REACH), k - 1, right)
        return left, right

    left, right = _kept(some, sides)
    value, variance, spread, low, high = _windows(rows.weight, running, left, right, some)

    def doubts() -> tuple[Array, Array]:
        """The most doubtful edge in the window, and the row before it."""
        most, at = jnp.zeros_like(doubt), jnp.full(doubt.shape, _REACH, jnp.int32)
        for k in range(-_REACH, _REACH):
            there = jnp.where((k >= -low) & (k < high), _shifted(doubt, k), 0.0)
            at, most = jnp.where(there > most, k, at), jnp.maximum(there, most)
        return most, at

    most, at = _kept(some, doubts)
    doubtful = most > 0

    # The same with windows that end there, of the few rows that have one.
    ends = jnp.where(at < 0, -at - 1, left), jnp.where(at < 0, right, at)
    fields = rows.weight, running.x, running.y, running.at, *ends
    places, total, back = packed(doubtful.reshape(-1), _TOGETHER)

    def again(block: Array, found: Array) -> Array:
        here = lax.dynamic_slice_in_dim(places, block * _TOGETHER, _TOGETHER)
        weight, x, y, sums, first, last = (field.reshape(-1)[here] for field in fields)
        part = _windows(weight, running._replace(x=x, y=y, at=sums), first, last, some)
        return lax.dynamic_update_slice_in_dim(found, jnp.stack(part[:2]), block * _TOGETHER, 1)

    others = lax.fori_loop(0, -(-total // _TOGETHER), again, jnp.zeros((2, places.size), value.dtype))
    without = others[:, jnp.maximum(back, 0).reshape(doubtful.shape)]
    count = rows.x.shape[1]
    row = jnp.arange(count, dtype=jnp.int32)[None]
    line = lambda at: jnp.take_along_axis(rows.x, jnp.clip(at, 0, count - 1), 1)
    shared = spread * (line(row + high) - line(row - low) + 1.0)
    share = jnp.where(doubtful, 1.0 / (1.0 + jnp.exp(0.5 * (_EVEN - most))), 0.0)
    apart = without[0] - value
    mixed = variance + share * (without[1] - variance + (1.0 - share) * apart**2)
    return value + share * apart, mixed, shared


def _windows(
    weight: Array, running: _Running, left: Array, right: Array, some: Bool[Array, ""]
) -> tuple[Array, Array, Array, Array, Array]:
    """For every row a parabola in the largest window that it fits and whose value agrees with those of smaller ones.

    Returns:
        Centre minus that of the row, its variance, that of the window's lines over their number, and the rows of the
        window on either side.
    """

    def reach(size: Array) -> tuple[Array, Array]:
        # A side that ends early is made up for on the other.
        first = jnp.minimum(left, 2 * size - jnp.minimum(right, size))
        return first, jnp.minimum(right, 2 * size - jnp.minimum(left, size))

    def fitted(_: None, size: Array) -> tuple[None, tuple[Array, ...]]:
        sums = _kept(some, lambda: running.windows(*reach(size)))
        value, variance, explained = _parabola(sums)
        return None, (value, variance, sums[8] - explained, sums[0], sums[9])

    # The loop keeps the few numbers of each size; what is made of them is cheap.
    _, fits = lax.scan(fitted, None, jnp.asarray(_SIZES, jnp.int32))

    def chosen() -> tuple[Array, ...]:
        alone = 1.0 / jnp.where(weight > 0, weight, 1.0)
        zero = jnp.zeros_like(left)
        state, goes_on = (jnp.zeros_like(alone), alone, alone, zero, zero), jnp.ones(alone.shape, jnp.bool_)
        for number, size in enumerate(_SIZES.tolist()):
            value, variance, _, low, high = state
            found, own, chi2, total, used = (field[number] for field in fits)
            told = (used >= 5.0) & (own >= 0)
            freedom = jnp.where(told, used - 3.0, 2.0)
            single = (low == 0) & (high == 0)
            most, far = jnp.where(single, _MISFIT[0], _MISFIT[1]), jnp.where(single, _APART[0], _APART[1])
            fit = chi2 <= freedom + most * jnp.sqrt(2.0 * freedom)
            fit &= jnp.abs(found - value) <= far * jnp.sqrt(jnp.maximum(variance - own, 0.0))
            # Residuals of the parabola beyond the noise count as noise.
            excess = jnp.maximum(chi2 / freedom, 1.0)
            better = goes_on & told & fit & (excess * own < variance)
            new = found, excess * own, excess / jnp.where(total > 0, total, 1.0), *reach(size)
            state = tuple(jnp.where(better, a, b) for a, b in zip(new, state, strict=True))
            goes_on &= fit | ~told
        return state

    value, variance, spread, low, high = _kept(some, chosen)
    return value, variance, spread, low, high


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
    known = det > 1e-9 * s0 * s2
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


def _parabola(sums: list[Array]) -> tuple[Array, Array, Array]:
    """Value of a parabola at 0, the value's variance (-1 without a parabola), and what it explains."""
    s0, s1, s2, s3, s4, t0, t1, t2 = sums[:8]
    (c00, c01, c02, c11, c12, c22), part, known = _cofactors(s0, s1, s2, s3, s4)
    a0, a1, a2 = c00 * t0 + c01 * t1 + c02 * t2, c01 * t0 + c11 * t1 + c12 * t2, c02 * t0 + c12 * t1 + c22 * t2
    return a0 * part, jnp.where(known, c00 * part, -1.0), (a0 * t0 + a1 * t1 + a2 * t2) * part
