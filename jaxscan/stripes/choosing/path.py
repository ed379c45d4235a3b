r"""Which candidate of each line is the stripe: the best path over the lines of a frame.

A stripe goes on from line to line; a reflection rarely does. On every line the path takes
one candidate or none. A candidate adds to the score of the path

$$\min(\tfrac12 \mathrm{snr}^2, E) - \tfrac12 s_0^2,$$

the logarithm of its likelihood ratio against noise, less that of the faintest stripe that is
believed on a line of its own. It is cut off at E, so that one bright reflection does not outweigh
many lines; a path that takes none on a line loses the part of its best candidate beyond E. From
one line to the next a path adds and pays

$$\tfrac12 (s_0^2 - s_1^2) - \min(\lambda |\Delta u|, J),$$

so that lines that continue each other need less signal each, and a jump costs the same however
far it goes: depth has edges. The width may change slowly only. Where a line takes none, the last
centre is remembered, but counts less.

Source: dynamic programming along a stripe as of A. J. Viterbi, Error bounds for convolutional
codes, IEEE Trans. Inf. Theory 13, 1967, with costs that saturate.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Int8

from jaxscan.geometry import Array
from jaxscan.stripes.stripes import FrameStripes


_EVIDENCE = 20.0
"""Evidence beyond which a candidate is not better than another one."""
_CERTAIN_SNR = 14.0
"""Signal-to-noise ratio beyond which no more is lost by taking none [1]."""
_JUMP = 30.0
"""Largest cost of a change of the centre."""
_PER_PX = 0.3
"""Cost of a change of the centre [1/px]."""
_GAP_JUMP = 8.0
"""Largest cost of a change of the centre over lines without any."""
_WIDTH_COST = 0.5
"""Cost of a change of the width, per natural logarithm, up to one."""
_NEVER = -1e6
_BRIGHTER = 0.02
"""Score per natural logarithm of the amplitude."""
COSTS = (_EVIDENCE, _CERTAIN_SNR, _JUMP, _PER_PX, _GAP_JUMP, _WIDTH_COST, _BRIGHTER, _NEVER)
"""All of them, for native code."""


def best_path(candidates: FrameStripes, *, alone_snr: float, continued_snr: float) -> Int8[Array, "frames lines"]:
    """The candidate on the best path of every line, or -1.

    Args:
        candidates: The candidates of every line; those that are not valid are never taken.
        alone_snr: Signal-to-noise ratio that a line on its own must exceed [1].
        continued_snr: The same where the neighbours continue the line [1].
    """
    u, snr, valid = candidates.u, candidates.snr, candidates.valid
    amplitude, width = jnp.maximum(candidates.amplitude, 1.0), jnp.maximum(candidates.width, 0.1)
    frames, _, count = u.shape
    bonus = 0.5 * (alone_snr**2 - continued_snr**2)
    full = 0.5 * jnp.minimum(jnp.where(valid, snr, 0.0), _CERTAIN_SNR) ** 2
    score = jnp.minimum(full, _EVIDENCE) - 0.5 * alone_snr**2 + _BRIGHTER * jnp.log(amplitude)
    score = jnp.where(valid, score, _NEVER)
    lost = jnp.maximum(jnp.max(full, axis=2) - _EVIDENCE, 0.0)
    # Lines first, for the loop; then every operation is one vector over frames.
    place, score, log_width = (jnp.moveaxis(values, 0, 2) for values in (u, score, jnp.log(width)))

    def best_of(scores):
        best, origin = scores[0], jnp.zeros(frames, jnp.int8)
        for number, score in enumerate(scores[1:], 1):
            better = score > best
            best, origin = jnp.where(better, score, best), jnp.where(better, jnp.int8(number), origin)
        return best, origin

    def forward(state, line):
        # State 0 is none, with the centre of the last candidate before it.
        scores, places, widths = state
        here, scores_here, widths_here, lost_here = line
        best, origin = best_of(scores)
        remembered = places[0]
        for k in range(1, count + 1):
            remembered = jnp.where(origin == k, places[k], remembered)
        new_scores, origins = [best - lost_here], [origin]
        for k in range(count):
            moved = [scores[0] - jnp.minimum(_PER_PX * jnp.abs(here[k] - places[0]), _GAP_JUMP)]
            for j in range(1, count + 1):
                change = jnp.minimum(_PER_PX * jnp.abs(here[k] - places[j]), _JUMP)
                change += _WIDTH_COST * jnp.minimum(jnp.abs(widths_here[k] - widths[j - 1]), 1.0)
                moved.append(scores[j] + bonus - change)
            best, origin = best_of(moved)
            new_scores.append(best + scores_here[k])
            origins.append(origin)
        return (new_scores, [remembered, *here], list(widths_here)), jnp.stack(origins)

    zero = jnp.zeros(frames, u.dtype)
    # Nothing is remembered at first: a place so far away costs the same for all.
    first = ([zero] + [zero + _NEVER] * count, [zero + _NEVER] + [zero] * count, [zero] * count)
    (scores, _, _), origins = lax.scan(forward, first, (place, score, log_width, lost.T))
    _, last = best_of(scores)

    def backward(taken, origin):
        before = origin[0]
        for k in range(1, count + 1):
            before = jnp.where(taken == k, origin[k], before)
        return before, taken

    _, path = lax.scan(backward, last, origins, reverse=True)
    return path.T - jnp.int8(1)
