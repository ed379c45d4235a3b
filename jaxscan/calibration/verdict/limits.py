"""Every limit by which a calibration is judged: reports and files only put into words what is decided here."""

from collections.abc import Sequence
from typing import Literal


ACCEPTED_P = 0.01
"""Chance of refusing good data, all tests together."""

# Priors should only hold what nothing else does: a larger share of the cost than this is a warning.
_PRIOR_COST = 0.01
# So is a larger share of rejected corners or stripe points.
_REJECTED = 0.03
# A view whose corners, rejected ones included, are this many times as far off as usual is a warning.
_ODD_VIEW = 4.0
# A view stands out if its kept corners are this many times as far off as usual, or this share is rejected.
_BAD_RATIO, _BAD_SHARE = 2.0, 0.2
# Whitened residuals between these are as large as the detector promised.
_QUIET, _NOISY = 0.75, 1.33
# A direction of which the priors know more than this share is theirs rather than the data's.
_PRIOR_SHARE = 0.5

Result = Literal["passes", "noisy", "fails"]
"""A test "fails" where the residuals have structure; they are "noisy" where they are only larger than promised."""


def chance(p: Sequence[float]) -> float:
    """Probability that chance alone gives one of several tests a p as small as the smallest (Bonferroni's bound)."""
    return min(1.0, len(p) * min(p)) if p else 1.0


def result_of_test(p: float, p_structure: float, tests: int) -> Result:
    """How one of several tests ended; together they refuse good data with `ACCEPTED_P`."""
    limit = ACCEPTED_P / tests
    if p_structure <= limit:
        return "fails"
    return "noisy" if p <= limit else "passes"


def noise_kind(ratio: float) -> Literal["quiet", "promised", "noisy"]:
    """How residuals of a whitened RMS compare with the promise of their detector."""
    return "noisy" if ratio > _NOISY else "quiet" if ratio < _QUIET else "promised"


def is_held_by_priors(sigma_over_prior: float) -> bool:
    """Whether a direction is known from priors rather than from the data."""
    return sigma_over_prior**2 > _PRIOR_SHARE


def too_much_prior(cost_share: float) -> bool:
    """Whether the priors carry more of the cost than they should."""
    return cost_share > _PRIOR_COST


def many_rejected(rejected: int, count: int) -> bool:
    """Whether so many corners or stripe points were rejected that it is worth a warning."""
    return rejected > _REJECTED * max(count, 1)


def is_odd_view(rms_px: float, usual_px: float) -> bool:
    """Whether a view's corners, rejected ones included, are so far off that it is worth a warning."""
    return rms_px > _ODD_VIEW * usual_px


def is_far_off(kept_rms_px: float, usual_px: float) -> bool:
    """Whether the kept corners of a view stand out."""
    return kept_rms_px > _BAD_RATIO * usual_px > 0


def view_lost_many(rejected: int, corners: int) -> bool:
    """Whether the share of rejected corners makes a view stand out."""
    return rejected > _BAD_SHARE * corners
