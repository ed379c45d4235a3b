"""Strays, and edges between the surfaces of a profile."""

from typing import no_type_check

from jaxscan.stripes.smoothing.loops.rows import (
    A0,
    A1,
    A2,
    AROUND,
    B0,
    B1,
    BLOCK,
    GOES_ON,
    LINES,
    MARGIN,
    RESULT,
    S0,
    S1,
    S2,
    S3,
    S4,
    T0,
    T1,
    T2,
    E,
    W,
    X,
    Y,
    clear,
    fill,
    line,
    parabola,
    part,
    u64,
)


@part
@no_type_check
def find_strays(r, w, limits, count):
    """Into RESULT 1 for centres that lie off a straight line on which two neighbours on either side agree."""
    gap, most, agree = limits
    for i in range(count):
        far, near = u64(i - u64(2)), u64(i - u64(1))
        after, behind = u64(i + u64(1)), u64(i + u64(2))
        here, level = r[X + i], r[Y + i]
        d0, d1, d2, d3 = r[X + far] - here, r[X + near] - here, r[X + after] - here, r[X + behind] - here
        v0, v1, v2, v3 = r[Y + far] - level, r[Y + near] - level, r[Y + after] - level, r[Y + behind] - level
        w0, w1, w2, w3 = r[W + far], r[W + near], r[W + after], r[W + behind]
        s1, s2 = w0 * d0 + w1 * d1 + w2 * d2 + w3 * d3, w0 * d0 * d0 + w1 * d1 * d1 + w2 * d2 * d2 + w3 * d3 * d3
        t0, t1 = w0 * v0 + w1 * v1 + w2 * v2 + w3 * v3, w0 * d0 * v0 + w1 * d1 * v1 + w2 * d2 * v2 + w3 * d3 * v3
        q = w0 * v0 * v0 + w1 * v1 * v1 + w2 * v2 * v2 + w3 * v3 * v3
        value, slope, variance = line(w0 + w1 + w2 + w3, s1, s2, t0, t1)
        # Four of them, none of the margin, and near.
        whole = (w0 * w1 * w2 * w3 > 0.0) & (d3 - d0 <= 4.0 + gap) & (variance > 0.0)
        stray = (q - value * t0 - slope * t1 < agree) & (value * value > most * most * (variance + 1.0 / r[W + i]))
        w[RESULT + i] = 1.0 if whole & stray else 0.0


@part
@no_type_check
def _add_to_side(r, w, shift, ends, count):
    """Add the neighbours `shift` away to the sums of one side of a possible edge, as far as no edge is between."""
    for i in range(count):
        d, v = r[X + shift + i] - 0.5 * (r[X + i] + r[X + u64(1) + i]), r[Y + shift + i] - r[Y + i]
        weight = r[W + shift + i] * w[GOES_ON + i]
        wd = weight * d
        wdd = wd * d
        w[A0 + i] += weight
        w[A1 + i] += wd
        w[A2 + i] += wdd
        w[B0 + i] += weight * v
        w[B1 + i] += wd * v
        w[S3 + i] += wdd * d
        w[S4 + i] += wdd * d * d
        w[T2 + i] += wdd * v
        w[GOES_ON + i] *= 1.0 - r[E + ends + i]


@part
@no_type_check
def _finish_side(w, count):
    """Add one side to both; LINES becomes -1 where it has no straight line."""
    for i in range(count):
        a0, a1, a2, b0, b1 = w[A0 + i], w[A1 + i], w[A2 + i], w[B0 + i], w[B1 + i]
        value, slope, variance = line(a0, a1, a2, b0, b1)
        lines = w[LINES + i] + value * b0 + slope * b1
        w[LINES + i] = lines if (variance >= 0.0) & (w[LINES + i] >= 0.0) else -1.0
        w[S0 + i] += a0
        w[S1 + i] += a1
        w[S2 + i] += a2
        w[T0 + i] += b0
        w[T1 + i] += b1
        w[A0 + i] = w[A1 + i] = w[A2 + i] = w[B0 + i] = w[B1 + i] = 0.0
        w[GOES_ON + i] = 1.0


@part
@no_type_check
def _compare(r, w, straight, count):
    """Into RESULT the chi-squared by which both lines are better than one parabola. A curved surface is no edge."""
    for i in range(count):
        s4 = w[S4 + i] + 0.25 * (r[W + i] + r[W + u64(1) + i]) * straight
        s, t = (w[S0 + i], w[S1 + i], w[S2 + i], w[S3 + i], s4), (w[T0 + i], w[T1 + i], w[T2 + i])
        value, slope, curve, own = parabola(s, t)
        better = w[LINES + i] - value * t[0] - slope * t[1] - curve * t[2]
        w[RESULT + i] = better if (own > 0.0) & (w[LINES + i] >= 0.0) & (r[E + i] == 0.0) else 0.0


@part
@no_type_check
def mark_edges(memory, rows, count, doubt, height, rules):
    """Whether row i and the next one are on two surfaces: first by few rows, then by more that end at known edges.

    Also the chi-squared of places that may be edges, and are none for certain.
    """
    (r, w), x, edge = memory, rows[0], rows[3]
    n = u64(BLOCK)
    for i in range(MARGIN, MARGIN + count - 1):
        edge[i] = 1.0 if x[i + 1] - x[i] > rules.gap else 0.0
    for size in rules.sizes:
        for start in range(0, count, BLOCK):
            fill(r, rows, u64(start), u64(AROUND))
            clear(w, S0, u64(BLOCK * 15))
            clear(w, LINES, n)
            for i in range(n):
                w[GOES_ON + i] = 1.0
            for step in range(size):
                _add_to_side(r, w, u64(-step), u64(-step - 1), n)
            _finish_side(w, n)
            for step in range(size):
                _add_to_side(r, w, u64(step + 1), u64(step + 1), n)
            _finish_side(w, n)
            _compare(r, w, rules.straight, n)
            for i in range(min(BLOCK, count - 1 - start)):
                height[MARGIN + start + i] = w[RESULT + u64(i)]
        for i in range(MARGIN, MARGIN + count - 1):
            if height[i] > rules.doubt:
                highest = True
                # Those beside an edge look across it.
                for k in range(max(i - size + 1, MARGIN), min(i + size, MARGIN + count - 1)):
                    if height[k] > height[i]:
                        highest = False
                if highest:
                    if height[i] > rules.edge:
                        edge[i] = 1.0
                    doubt[i] = max(doubt[i], height[i])


@part
@no_type_check
def find_surfaces(x, edge, count, reach, left, right):
    """Rows on either side of each that are on its surface and not farther away than `reach`."""
    begin = MARGIN
    for i in range(MARGIN, MARGIN + count):
        if edge[i - 1] > 0.0:
            begin = i
        rows = min(i - begin, reach)
        while x[i] - x[i - rows] > reach:
            rows -= 1
        left[i] = rows
    end = MARGIN + count - 1
    for i in range(MARGIN + count - 1, MARGIN - 1, -1):
        if i < MARGIN + count - 1 and edge[i] > 0.0:
            end = i
        rows = min(end - i, reach)
        while x[i + rows] - x[i] > reach:
            rows -= 1
        right[i] = rows
