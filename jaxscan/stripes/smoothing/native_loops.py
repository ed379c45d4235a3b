"""The loops of the smoothing: a profile at a time, in double precision.

Numbers of other files come as arguments: the compiled code is kept on disk, and only a change of this file
would renew it.
"""

from typing import no_type_check

import numba
import numpy as np


# Sums may be fused and quotients become products: faster by a third.
_FAST = {"contract", "arcp", "nsz"}
_part = numba.njit(nogil=True, fastmath=_FAST)
_inlined = numba.njit(nogil=True, inline="always")
# Only `smooth_block` is cached on disk: functions that are cached one by one are not inlined into each other.
_whole = numba.njit(nogil=True, cache=True, fastmath=_FAST)


@_inlined
@no_type_check
def _line(s0, s1, s2, t0, t1):
    """Of a weighted straight line at 0: value, slope, their variances and covariance; no variance without a line."""
    det = s0 * s2 - s1 * s1
    if not det > 1e-9 * s0 * s2:
        return 0.0, 0.0, -1.0, -1.0, 0.0
    part = 1.0 / det
    return (s2 * t0 - s1 * t1) * part, (s0 * t1 - s1 * t0) * part, s2 * part, s0 * part, -s1 * part


@_inlined
@no_type_check
def _parabola(s, t):
    """Of a weighted parabola at 0: value, slope, curvature, and the value's variance; none without a parabola."""
    (s0, s1, s2, s3, s4), (t0, t1, t2) = s, t
    c00, c01, c02 = s2 * s4 - s3 * s3, s2 * s3 - s1 * s4, s1 * s3 - s2 * s2
    det = s0 * c00 + s1 * c01 + s2 * c02
    if not det > 1e-9 * s0 * s2 * s4:
        return 0.0, 0.0, 0.0, -1.0
    part, c12 = 1.0 / det, s1 * s2 - s0 * s3
    value = (c00 * t0 + c01 * t1 + c02 * t2) * part
    slope = (c01 * t0 + (s0 * s4 - s2 * s2) * t1 + c12 * t2) * part
    return value, slope, (c02 * t0 + c12 * t1 + (s0 * s2 - s1 * s1) * t2) * part, c00 * part


@_part
@no_type_check
def _mark_strays(x, y, weight, rules):
    """Take the weight of centres that lie off a straight line on which two neighbours on either side agree."""
    count = len(x)
    stray = np.zeros(count, np.bool_)
    for i in range(2, count - 2):
        if x[i + 2] - x[i - 2] > 4.0 + rules.gap:
            continue
        s0 = s1 = s2 = t0 = t1 = q = 0.0
        for k in (i - 2, i - 1, i + 1, i + 2):
            d, v, w = x[k] - x[i], y[k] - y[i], weight[k]
            s0 += w
            s1 += w * d
            s2 += w * d * d
            t0 += w * v
            t1 += w * d * v
            q += w * v * v
        value, slope, variance, _, _ = _line(s0, s1, s2, t0, t1)
        agree = variance > 0.0 and q - value * t0 - slope * t1 < rules.agree
        stray[i] = agree and value * value > rules.stray**2 * (variance + 1.0 / weight[i])
    for i in range(count):
        if stray[i]:
            weight[i] = 0.0


@_part
@no_type_check
def _step(rows, edge, i, size, rules):
    """Chi-squared by which straight lines through so many rows up to i and after it are better than a parabola.

    They end at the edges that are known. A curved surface is no edge.
    """
    x, y, weight = rows
    count = len(x)
    at, level = 0.5 * (x[i] + x[i + 1]), y[i]
    s0 = s1 = s2 = s3 = s4 = t0 = t1 = t2 = lines = 0.0
    for side in range(2):
        a0 = a1 = a2 = b0 = b1 = 0.0
        for n in range(size):
            k = i - n if side == 0 else i + 1 + n
            if k < 0 or k >= count:
                break
            d, v, w = x[k] - at, y[k] - level, weight[k]
            wd, wdd = w * d, w * d * d
            a0 += w
            a1 += wd
            a2 += wdd
            b0 += w * v
            b1 += wd * v
            s3 += wdd * d
            s4 += wdd * d * d
            t2 += wdd * v
            if (side == 0 and k > 0 and edge[k - 1]) or (side == 1 and k < count - 1 and edge[k]):
                break
        value, slope, variance, _, _ = _line(a0, a1, a2, b0, b1)
        if variance < 0.0:
            return 0.0
        lines += value * b0 + slope * b1
        s0 += a0
        s1 += a1
        s2 += a2
        t0 += b0
        t1 += b1
    s4 += 0.25 * (weight[i] + weight[i + 1]) * rules.straight
    value, slope, curve, own = _parabola((s0, s1, s2, s3, s4), (t0, t1, t2))
    return lines - value * t0 - slope * t1 - curve * t2 if own > 0.0 else 0.0


@_part
@no_type_check
def _mark_edges(x, y, weight, rules):
    """Whether row i and the next one are on two surfaces: first by few rows, then by more that end at known edges.

    Also the chi-squared of places that may be edges, and are none for certain.
    """
    count = len(x)
    edge = np.zeros(max(count - 1, 0), np.bool_)
    height, doubt = np.zeros(max(count - 1, 0)), np.zeros(max(count - 1, 0))
    for i in range(count - 1):
        edge[i] = x[i + 1] - x[i] > rules.gap
    for size in rules.sizes:
        for i in range(count - 1):
            height[i] = 0.0 if edge[i] else _step((x, y, weight), edge, i, size, rules)
        for i in range(count - 1):
            if height[i] > rules.doubt:
                highest = True
                # Those beside an edge look across it.
                for k in range(max(i - size + 1, 0), min(i + size, count - 1)):
                    if height[k] > height[i]:
                        highest = False
                if highest:
                    edge[i] |= height[i] > rules.edge
                    doubt[i] = max(doubt[i], height[i])
    return edge, doubt


@_part
@no_type_check
def _fit(x, y, weight, ends, i, rules):
    """Value of a parabola at i in the largest window that it fits and whose value agrees with those of smaller ones.

    Returns:
        Centre minus that of the row, its variance, that of the window's lines, and its first and last row.
    """
    left, right = ends
    here, level = x[i], y[i]
    s0 = s1 = s2 = s3 = s4 = t0 = t1 = t2 = q = 0.0
    used, low, high = 0, i, i - 1
    best = (0.0, 1.0 / weight[i], 1.0 / weight[i], i, i)
    for size in rules.sizes:
        # A side that ends early is made up for on the other.
        first, last = i - min(left, size + size - min(right, size)), i + min(right, size + size - min(left, size))
        for part in range(2):
            for k in range(first if part == 0 else high + 1, low if part == 0 else last + 1):
                d, v, w = x[k] - here, y[k] - level, weight[k]
                used += w > 0.0
                wd = w * d
                wdd = wd * d
                s0 += w
                s1 += wd
                s2 += wdd
                s3 += wdd * d
                s4 += wdd * d * d
                t0 += w * v
                t1 += wd * v
                t2 += wdd * v
                q += w * v * v
            if part == 0:
                low = first
        high = last
        value, slope, curve, own = _parabola((s0, s1, s2, s3, s4), (t0, t1, t2))
        if used < 5 or own < 0.0:
            continue
        chi2, freedom = q - value * t0 - slope * t1 - curve * t2, used - 3.0
        alone = best[3] == best[4]
        misfit, apart = (rules.first_misfit, rules.first_apart) if alone else (rules.misfit, rules.apart)
        if chi2 > freedom + misfit * np.sqrt(2.0 * freedom):
            break
        if abs(value - best[0]) > apart * np.sqrt(max(best[1] - own, 0.0)):
            break
        # Residuals of the parabola beyond the noise count as noise.
        excess = max(1.0, chi2 / freedom)
        if excess * own < best[1]:
            best = (value, excess * own, excess * (x[high] - x[low] + 1.0) / s0, low, high)
    return best


@_part
@no_type_check
def _rows_before(x, edge, i, reach):
    """Rows before i on its surface."""
    rows = 0
    while i - rows > 0 and rows < reach and not edge[i - rows - 1] and x[i] - x[i - rows - 1] <= reach:
        rows += 1
    return rows


@_part
@no_type_check
def _rows_after(x, edge, i, reach):
    """Rows after i on its surface."""
    rows = 0
    while i + rows + 1 < len(x) and rows < reach and not edge[i + rows] and x[i + rows + 1] - x[i] <= reach:
        rows += 1
    return rows


@_part
@no_type_check
def _between(rows, edges, i, rules):
    """Centre at i, its variance and shared lines, from a window that ends at edges.

    Where an edge is in doubt, both answers count by their odds.
    """
    (x, y, weight), (edge, doubt), reach = rows, edges, 2 * rules.sizes[-1]
    left, right = _rows_before(x, edge, i, reach), _rows_after(x, edge, i, reach)
    value, variance, of_lines, low, high = _fit(x, y, weight, (left, right), i, rules)
    at, most = -1, 0.0
    for k in range(low, high):
        if doubt[k] > most:
            at, most = k, doubt[k]
    if at >= 0:
        ends = (i - at - 1, right) if at < i else (left, at - i)
        other, wider, _, _, _ = _fit(x, y, weight, ends, i, rules)
        share = 1.0 / (1.0 + np.exp(0.5 * (rules.even - most)))
        variance += share * (wider - variance + (1.0 - share) * (other - value) ** 2)
        value += share * (other - value)
    variance = min(variance, 1.0 / weight[i])
    # So an average of smoothed centres is stated as good as that of the rows.
    return y[i] + value, variance, max(of_lines / variance, 1.0)


@_whole
@no_type_check
def smooth_block(u, sigma, valid, lines, rules, found):
    """Fill `found` (centre, sigma, shared lines: three arrays [profiles, lines]) from those of the rows.

    `lines` are those that a centre can lie on.
    """
    centre, deviation, share = found
    for profile in range(u.shape[0]):
        count = 0
        at = np.empty(len(lines), np.int64)
        for k in range(len(lines)):
            if valid[profile, lines[k]]:
                at[count] = k
                count += 1
        x, y, weight = np.empty(count), np.empty(count), np.empty(count)
        for k in range(count):
            line = lines[at[k]]
            x[k], y[k] = at[k], u[profile, line]
            weight[k] = 1.0 / sigma[profile, line] ** 2
        kept = weight.copy()
        _mark_strays(x, y, kept, rules)
        edge, doubt = _mark_edges(x, y, kept, rules)
        for k in range(count):
            line = lines[at[k]]
            if kept[k] > 0.0:
                best, variance, shared = _between((x, y, kept), (edge, doubt), k, rules)
            else:
                best, variance, shared = y[k], 1.0 / weight[k], 1.0
            centre[profile, line], deviation[profile, line] = best, np.sqrt(variance)
            share[profile, line] = shared
