"""Every limit by which a calibration is judged; reports only word the decisions that are made with them."""

from collections.abc import Sequence
from typing import Literal


STRUCTURE_P = 0.01
"""Chance of finding structure in good data, all tests together."""
USELESS_SHARE = 0.05
"""A calibration cannot be used where its points are off by more than this share of their distance, or its rays by more
than this share of the focal length, which is the same: a room of 4 m wrong by 20 cm is told better by pacing it."""
UNKNOWN_FOCAL = 0.03
"""A camera whose focal length is known no better than to this share is not determined by its views."""
_NAMED_SHARE = 0.3
"""A cause is named where its part is at least this share of the whole: a smaller one adds less than 5 % to it."""

PRIOR_COST = 0.01
"""A larger share of the priors in the cost is worth a warning: they should only hold unknowns that the data do not."""
REJECTED = 0.03
"""So is a larger share of rejected corners or stripe points ..."""
ODD_VIEW = 4.0
"""... and a view whose corners, rejected ones included, are this many times as far off as usual."""
FAR_OFF, MANY_REJECTED = 2.0, 0.2
"""A view stands out if its kept corners are this many times as far off as usual, or this share is rejected."""
# Whitened residuals between these are as large as the detector promised.
_QUIET, _NOISY = 0.75, 1.33
# A direction of which the priors know more than this share is theirs rather than the data's.
_PRIOR_SHARE = 0.5

Result = Literal["passes", "noisy", "structure"]
"""The outcome of a test: "structure" in the residuals, or residuals that are only larger than promised ("noisy")."""


def chance(p: Sequence[float]) -> float:
    """Probability that chance alone gives one of several tests a p as small as the smallest (Bonferroni's bound)."""
    return min(1.0, len(p) * min(p)) if p else 1.0


def result_of_test(p: float, p_structure: float, tests: int) -> Result:
    """How one of several tests ended; together they find structure in good data with `STRUCTURE_P`."""
    limit = STRUCTURE_P / tests
    if p_structure <= limit:
        return "structure"
    return "noisy" if p <= limit else "passes"


def noise_kind(ratio: float) -> Literal["quiet", "promised", "noisy"]:
    """How residuals of a whitened RMS compare with the promise of their detector."""
    return "noisy" if ratio > _NOISY else "quiet" if ratio < _QUIET else "promised"


def is_held_by_priors(sigma_over_prior: float) -> bool:
    """Whether a direction is known from priors rather than from the data."""
    return sigma_over_prior**2 > _PRIOR_SHARE


def is_named(part: float, whole: float) -> bool:
    """Whether a cause's part of a standard deviation is worth a word."""
    return part > _NAMED_SHARE * whole
