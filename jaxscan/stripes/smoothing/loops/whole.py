"""The smoothing of profiles: of this folder, `smooth_block` alone is kept on disk."""

from typing import NamedTuple, no_type_check

import numpy as np

from jaxscan.stripes.smoothing.loops import edges, rows, windows
from jaxscan.stripes.smoothing.loops.edges import find_strays, find_surfaces, mark_edges
from jaxscan.stripes.smoothing.loops.rows import AROUND, BLOCK, MARGIN, RESULT, SUMS, clear, fill, part, u64, whole
from jaxscan.stripes.smoothing.loops.windows import smooth_rows
from jaxscan.stripes.sources import fingerprint


class Memory(NamedTuple):
    """Of one profile and one block."""

    rows: np.ndarray
    """float64 [12, lines and margins]."""
    at: np.ndarray
    """Lines, int64 [lines and margins]."""
    number: np.ndarray
    """Doubtful edges up to each, int64 [lines and margins]."""
    around: np.ndarray
    sums: np.ndarray


def memory_of(lines: int) -> Memory:
    """For profiles of so many lines."""
    room = lines + 2 * MARGIN + BLOCK
    at, number = (np.zeros(room + 1, np.int64) for _ in range(2))
    return Memory(np.zeros((12, room)), at, number, np.zeros(4 * AROUND), np.zeros(SUMS * BLOCK))


@part
@no_type_check
def _gather(fields, lines, profile, into):
    """The valid centres of a profile one after the other; their number."""
    (u, sigma, valid), (at, x, y, own) = fields, into
    count = 0
    for k in range(len(lines)):
        line = lines[k]
        if valid[profile, line]:
            at[count] = line
            x[MARGIN + count], y[MARGIN + count] = k, u[profile, line]
            own[MARGIN + count] = 1.0 / (sigma[profile, line] * sigma[profile, line])
            count += 1
    return count


@part
@no_type_check
def _drop_strays(r, w, rows, own, count, limits):
    """Take the weight of centres that lie off their neighbours."""
    x, y, weight, edge = rows
    for i in range(len(own)):
        weight[i] = own[i]
    for start in range(0, count, BLOCK):
        fill(r, (x, y, own, edge), u64(start), u64(AROUND))
        find_strays(r, w, limits, u64(BLOCK))
        for lane in range(min(BLOCK, count - start)):
            if w[RESULT + u64(lane)] > 0.0:
                weight[MARGIN + start + lane] = 0.0


def _made(sources):
    """`smooth_block`, compiled anew where any function of this folder changes: numba looks at this file alone."""

    @whole
    @no_type_check
    def smooth_block(fields, lines, rules, memory, found):
        """Smooth profiles.

        Args:
            fields: Centre, sigma, valid of the rows [profiles, lines].
            lines: Those that a centre can lie on.
            rules: Limits.
            memory: For profiles of so many lines.
            found: Centre, sigma, shared lines [profiles, lines], to be filled where there are centres.
        """
        # Of the closure, and so of the key under which the compiled code is kept.
        _ = sources
        to_centre, to_sigma, to_share = found
        rows, at, number, r, w = memory
        x, y, own, weight, edge, doubt = rows[0], rows[1], rows[2], rows[3], rows[4], rows[5]
        height, left, right, centre, variance, shared = rows[6], rows[7], rows[8], rows[9], rows[10], rows[11]
        everything, room = rows.reshape(-1), len(x)
        each = (x, y, weight, edge)
        for profile in range(len(to_centre)):
            clear(everything, u64(0), u64(everything.size))
            count = _gather(fields, lines, profile, (at, x, y, own))
            _drop_strays(r, w, each, own, count, (rules.gap, rules.stray, rules.agree))
            mark_edges((r, w), each, count, doubt, height, rules)
            for k in range(room):
                number[k + 1] = number[k] + (1 if doubt[k] > 0.0 else 0)
            find_surfaces(x, edge, count, 2 * rules.sizes[2], left, right)
            smooth_rows((r, w), each, (left, right), (doubt, number), (count, centre, variance, shared), rules)
            for k in range(count):
                i, line = MARGIN + k, at[k]
                best = 1.0 / own[i]
                to_centre[profile, line], to_share[profile, line] = y[i], 1.0
                if weight[i] > 0.0:
                    # So an average of smoothed centres is stated as good as that of the rows.
                    best = variance[i] if variance[i] < best else best
                    share = shared[i] / best
                    to_centre[profile, line] = y[i] + centre[i]
                    to_share[profile, line] = share if share > 1.0 else 1.0
                to_sigma[profile, line] = np.sqrt(best)

    return smooth_block


smooth_block = _made(fingerprint(rows, edges, windows))
