r"""Which candidate of each line is the stripe: the best path over the lines of a frame.

A stripe goes on from line to line; what only looks like it does not. On every line the path takes
one candidate or none. It gains

$$\tfrac12 \min(\mathrm{snr}, s_\infty)^2 - \tfrac12 s_0^2$$

for a candidate, the logarithm of the likelihood ratio against noise that must be exceeded for
a line on its own, and where two neighbouring lines both hold one

$$\tfrac12 (s_0^2 - s_1^2) - J \frac{t^2}{1 + t^2}, \qquad t = \Delta u / \ell,$$

so that lines that continue each other need less signal each, and a jump costs the same however
far it goes: depth has edges. The width may change slowly only, and the brighter of two counts
a little more. The signal counts up to $s_\infty$ only, or a bright reflection would buy its
way. Where a line takes none (occlusion), the next one starts afresh.

Source: dynamic programming along a stripe as of A. J. Viterbi, Error bounds for convolutional
codes, IEEE Trans. Inf. Theory 13, 1967; the robust cost is that of S. Geman and D. E. McClure.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Bool, Float, Int8

from jaxscan.geometry import Array


_ENOUGH_SNR = 12.0
"""Signal-to-noise ratio beyond which a candidate gains no more [1]."""
_JUMP = 14.0
"""Cost of a jump."""
_SMOOTH_PX = 2.0
"""Change of the centre from line to line that costs half a jump [px]."""
_WIDTH_COST = 4.0
"""Cost of a change of the width, per natural logarithm, up to one."""
_BRIGHTER = 0.15
"""Gain per natural logarithm of the amplitude."""


def best_path(
    u: Float[Array, "frames lines k"],
    snr: Float[Array, "frames lines k"],
    amplitude: Float[Array, "frames lines k"],
    width: Float[Array, "frames lines k"],
    valid: Bool[Array, "frames lines k"],
    *,
    alone_snr: float,
    continued_snr: float,
) -> Int8[Array, "frames lines"]:
    """The candidate on the best path of every line, or -1.

    Args:
        u: Centres [px].
        snr: Signal-to-noise ratios [1].
        amplitude: Amplitudes [DN].
        width: Standard deviations [px].
        valid: Which candidates may be taken.
        alone_snr: Signal-to-noise ratio that a line on its own must exceed [1].
        continued_snr: The same where the neighbours continue the line [1].
    """
    count = u.shape[2]
    frames = u.shape[0]
    bonus = 0.5 * (alone_snr**2 - continued_snr**2)
    energy = 0.5 * jnp.minimum(snr, _ENOUGH_SNR) ** 2 - 0.5 * alone_snr**2
    gain = energy + _BRIGHTER * jnp.log(jnp.maximum(amplitude, 1.0))
    gain = jnp.where(valid, gain, -1e6)
    # Lines first, for the loop; then every operation is one vector over frames.
    place, gain, log_width = (
        jnp.moveaxis(values, 0, 2) for values in (u / _SMOOTH_PX, gain, jnp.log(jnp.maximum(width, 0.1)))
    )

    def best_of(scores):
        best, origin = scores[0], jnp.zeros(frames, jnp.int8)
        for number, score in enumerate(scores[1:], 1):
            better = score > best
            best, origin = jnp.where(better, score, best), jnp.where(better, jnp.int8(number), origin)
        return best, origin

    def forward(state, line):
        scores, places, widths = state
        here, gains, widths_here = line
        reached = [best_of(scores)]
        for k in range(count):
            moved = []
            for j in range(count):
                t2 = (here[k] - places[j]) ** 2
                change = _WIDTH_COST * jnp.minimum(jnp.abs(widths_here[k] - widths[j]), 1.0)
                moved.append(scores[j + 1] + bonus - _JUMP * t2 / (1.0 + t2) - change)
            best, origin = best_of([scores[0], *moved])
            reached.append((best + gains[k], origin))
        new = ([best for best, _ in reached], list(here), list(widths_here))
        return new, jnp.stack([origin for _, origin in reached])

    zero = jnp.zeros(frames, u.dtype)
    first = ([zero] + [zero - 1e6] * count, [zero] * count, [zero] * count)
    (scores, _, _), origins = lax.scan(forward, first, (place, gain, log_width))
    _, last = best_of(scores)

    def backward(taken, origin):
        before = origin[0]
        for k in range(1, count + 1):
            before = jnp.where(taken == k, origin[k], before)
        return before, taken

    _, path = lax.scan(backward, last, origins, reverse=True)
    return path.T - jnp.int8(1)
