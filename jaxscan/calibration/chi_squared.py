"""The probability of a chi-squared by chance."""


def chance_of(chi2: float, freedom: int) -> float:
    """Probability of a larger chi-squared [1]; 1 without any freedom."""
    # Here, because it takes longer to load than to compute.
    from scipy.special import chdtrc  # type: ignore[import-untyped]

    return float(chdtrc(freedom, max(chi2, 0.0))) if freedom > 0 else 1.0
