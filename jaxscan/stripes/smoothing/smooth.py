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

Source: A. Savitzky, M. J. E. Golay, Smoothing and differentiation of data by simplified least squares procedures,
Anal. Chem. 36, 1964; windows of their own for every point: V. Katkovnik, A new method for varying adaptive bandwidth
selection, IEEE Trans. Signal Processing 47, 1999.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.stripes.frames import Sites
from jaxscan.stripes.smoothing.rules import Rules


_RULES = Rules(
    sizes=np.array([3, 6, 10]),
    gap=4.0,
    straight=4500.0,
    edge=12.0,
    doubt=5.0,
    even=9.0,
    stray=4.5,
    agree=16.0,
    misfit=1.8,
    apart=2.0,
    first_misfit=4.0,
    first_apart=3.5,
)
"""Half a window of 10 lines: of fewer lines more noise would be left, of more the surface itself would be smoothed."""
_EVERY_LINE = Sites()
_LEAST_PX = 1e-4
"""Smallest standard deviation of a centre that is believed."""


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
    # Here, because it loads numba: whoever smooths nothing does not wait for that.
    from jaxscan.stripes.smoothing.loops import memory_of, smooth_block

    u, sigma, valid = np.asarray(u), np.asarray(sigma), np.asarray(valid)
    found = Smoothed(*(np.zeros(u.shape, np.float32) for _ in Smoothed._fields))
    lines = np.arange(sites.first_line, u.shape[1], sites.line_step)
    fields = u, np.maximum(sigma, np.float32(_LEAST_PX)), valid
    smooth_block(fields, lines, _RULES, memory_of(len(lines)), tuple(found))
    if sites.line_step > 1:
        found.shared_lines[found.shared_lines > 1] *= sites.line_step
    return found
