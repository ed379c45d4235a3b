"""Parabolas in windows."""

from typing import no_type_check

import numpy as np

from jaxscan.stripes.smoothing.loops.rows import (
    AFTER,
    AROUND,
    BEFORE,
    BLOCK,
    FIRST,
    GOES_ON,
    HIGH,
    LAST,
    LEFT,
    LOW,
    MARGIN,
    NOW,
    RIGHT,
    S0,
    S1,
    S2,
    S3,
    S4,
    SPREAD,
    T0,
    T1,
    T2,
    THEN,
    USED,
    VALUE,
    VARIANCE,
    Q,
    W,
    X,
    Y,
    clear,
    fill,
    inlined,
    parabola,
    part,
    u64,
)


@part
@no_type_check
def _grow(w, size, count):
    """Into FIRST and LAST the reach of windows of a size. A side that ends early is made up for on the other."""
    for i in range(count):
        left, right = w[LEFT + i], w[RIGHT + i]
        w[BEFORE + i], w[AFTER + i] = w[FIRST + i], w[LAST + i]
        on_right = size + size - (left if left < size else size)
        on_left = size + size - (right if right < size else size)
        w[FIRST + i] = left if left < on_left else on_left
        w[LAST + i] = right if right < on_right else on_right


@part
@no_type_check
def _look(w, reach, count):
    """Copy the reach of the window and of the one before to where `_add` looks: its rows have to be known."""
    now, before = reach
    for i in range(count):
        w[NOW + i] = w[now + i]
    for i in range(count):
        w[THEN + i] = w[before + i]


@part
@no_type_check
def _add(r, w, shift, away, count):
    """Add the neighbours `shift` away, where they belong to the window and did not to the one before."""
    for i in range(count):
        inside = (away <= w[NOW + i]) & (away > w[THEN + i])
        d, v = r[X + shift + i] - r[X + i], r[Y + shift + i] - r[Y + i]
        weight = r[W + shift + i] if inside else 0.0
        wd = weight * d
        wdd, wv = wd * d, weight * v
        w[USED + i] += 1.0 if weight > 0.0 else 0.0
        w[S0 + i] += weight
        w[S1 + i] += wd
        w[S2 + i] += wdd
        w[S3 + i] += wdd * d
        w[S4 + i] += wdd * d * d
        w[T0 + i] += wv
        w[T1 + i] += wd * v
        w[T2 + i] += wdd * v
        w[Q + i] += wv * v


@part
@no_type_check
def _judge(w, limits, count):
    """Take the parabola of a window where it fits and its value agrees with that of the smaller one."""
    misfit, apart, first_misfit, first_apart = limits
    for i in range(count):
        s, t = (w[S0 + i], w[S1 + i], w[S2 + i], w[S3 + i], w[S4 + i]), (w[T0 + i], w[T1 + i], w[T2 + i])
        value, slope, curve, own = parabola(s, t)
        chi2, freedom = w[Q + i] - value * t[0] - slope * t[1] - curve * t[2], w[USED + i] - 3.0
        told = (freedom >= 2.0) & (own >= 0.0)
        freedom = freedom if told else 2.0
        alone = (w[LOW + i] == 0.0) & (w[HIGH + i] == 0.0)
        most, far = (first_misfit if alone else misfit), (first_apart if alone else apart)
        away, left = value - w[VALUE + i], w[VARIANCE + i] - own
        fits = chi2 <= freedom + most * np.sqrt(2.0 * freedom)
        fits &= (away if away > 0.0 else -away) <= far * np.sqrt(left if left > 0.0 else 0.0)
        # Residuals of the parabola beyond the noise count as noise.
        excess = chi2 / freedom
        excess = excess if excess > 1.0 else 1.0
        goes_on = w[GOES_ON + i] > 0.0
        better = goes_on & told & fits & (excess * own < w[VARIANCE + i])
        w[GOES_ON + i] = 1.0 if goes_on & (fits | (not told)) else 0.0
        w[VALUE + i] = value if better else w[VALUE + i]
        w[VARIANCE + i] = excess * own if better else w[VARIANCE + i]
        w[SPREAD + i] = excess / s[0] if better else w[SPREAD + i]
        w[LOW + i] = w[FIRST + i] if better else w[LOW + i]
        w[HIGH + i] = w[LAST + i] if better else w[HIGH + i]


@part
@no_type_check
def fit_windows(r, w, rules, n):
    """For every lane a parabola in the largest window that it fits and whose value agrees with those of smaller ones.

    The rows of VALUE to HIGH become: centre minus that of the row, its variance, that of the window's lines over their
    number, and the neighbours in the window on either side.
    """
    limits = (rules.misfit, rules.apart, rules.first_misfit, rules.first_apart)
    clear(w, S0, u64(10 * BLOCK))
    for i in range(n):
        alone = 1.0 / (r[W + i] if r[W + i] > 0.0 else 1.0)
        w[VALUE + i] = w[LOW + i] = w[HIGH + i] = w[FIRST + i] = 0.0
        w[VARIANCE + i] = w[SPREAD + i] = alone
        w[LAST + i], w[GOES_ON + i] = -1.0, 1.0
    for size in rules.sizes:
        _grow(w, float(size), n)
        first, last, left, right = MARGIN, MARGIN, 0, 0
        for i in range(n):
            first, left = min(first, np.int64(w[BEFORE + i])), max(left, np.int64(w[FIRST + i]))
            last, right = min(last, np.int64(w[AFTER + i])), max(right, np.int64(w[LAST + i]))
        _look(w, (FIRST, BEFORE), n)
        for away in range(first + 1, left + 1):
            _add(r, w, u64(-away), float(away), n)
        _look(w, (LAST, AFTER), n)
        for away in range(last + 1, right + 1):
            _add(r, w, u64(away), float(away), n)
        _judge(w, limits, n)


@inlined
@no_type_check
def _most_doubtful(doubt, number, low, high):
    """The most doubtful edge from row `low` to before row `high`; -1 for none."""
    at, most = -1, 0.0
    if number[high] > number[low]:
        for k in range(low, high):
            if doubt[k] > most:
                at, most = k, doubt[k]
    return at


@part
@no_type_check
def smooth_rows(memory, rows, sides, doubts, results, rules):
    """Centre minus that of the row, its variance, and its shared lines, of every row of a profile.

    Windows end at edges; where an edge is in doubt, the answers with and without it count by their odds.
    """
    (r, w), x, (left, right), (doubt, number) = memory, rows[0], sides, doubts
    count, centre, variance, shared = results
    n, at = u64(BLOCK), np.empty(BLOCK, np.int64)
    for start in range(0, count, BLOCK):
        fill(r, rows, u64(start), u64(AROUND))
        real, again = min(BLOCK, count - start), False
        for lane in range(BLOCK):
            k = MARGIN + start + lane
            w[LEFT + u64(lane)] = left[k] if lane < real else MARGIN - 1
            w[RIGHT + u64(lane)] = right[k] if lane < real else MARGIN - 1
        fit_windows(r, w, rules, n)
        for lane in range(real):
            i, k = u64(lane), MARGIN + start + lane
            low, high = k - np.int64(w[LOW + i]), k + np.int64(w[HIGH + i])
            centre[k], variance[k] = w[VALUE + i], w[VARIANCE + i]
            shared[k] = w[SPREAD + i] * (x[high] - x[low] + 1.0)
            at[lane] = _most_doubtful(doubt, number, low, high)
            if at[lane] >= 0:
                again = True
                if at[lane] < k:
                    w[LEFT + i] = k - at[lane] - 1
                else:
                    w[RIGHT + i] = at[lane] - k
        if not again:
            continue
        fit_windows(r, w, rules, n)
        for lane in range(real):
            if at[lane] >= 0:
                i, k = u64(lane), MARGIN + start + lane
                share = 1.0 / (1.0 + np.exp(0.5 * (rules.even - doubt[at[lane]])))
                other = w[VALUE + i] - centre[k]
                variance[k] += share * (w[VARIANCE + i] - variance[k] + (1.0 - share) * other**2)
                centre[k] += share * other
