r"""How wide the stripes of a sweep are, learned from its first frames.

Of a faint stripe the samples tell the width badly, and a fit of the wrong width finds a worse
centre. The width of the other stripes is therefore a prior: a normal distribution of the
logarithm of the width, whose spread is the stripes' own, without that of their noise.
"""

import numpy as np
from jaxtyping import Bool, Float


LEARNED_FRAMES = 8
"""Frames that are looked at."""
_LEAST_STRIPES = 100
"""With fewer nothing is learned."""
_LEAST_SPREAD = 0.1
"""Smallest standard deviation of the prior [1]."""
_WORST = 0.3
"""Standard deviation of a logarithm of the width up to which a stripe tells something [1]."""


def learn_widths(
    width: Float[np.ndarray, "frames lines"],
    sigma: Float[np.ndarray, "frames lines"],
    valid: Bool[np.ndarray, "frames lines"],
) -> tuple[float, float]:
    """Mean of the logarithm of the width [px], and the prior's information (0: nothing is known).

    Args:
        width: Fitted standard deviations of some frames' stripes [px].
        sigma: Standard deviation of their centres [px]; relative to the width that of a
            logarithm of the width too, as long as amplitude and width are unknown.
        valid: Which of them exist.
    """
    safe = np.where(valid, width, 1.0)
    noise = (sigma / safe) ** 2
    used = valid & (noise < _WORST**2)
    if np.count_nonzero(used) < _LEAST_STRIPES:
        return 0.0, 0.0
    # Integration over a pixel widens the stripe that the fit sees.
    logarithm = 0.5 * np.log(safe[used] ** 2 + 1 / 12)
    low, middle, high = np.percentile(logarithm, [15.9, 50.0, 84.1])
    own = max((0.5 * (high - low)) ** 2 - float(np.mean(noise[used])), _LEAST_SPREAD**2)
    return float(middle), 1.0 / own
