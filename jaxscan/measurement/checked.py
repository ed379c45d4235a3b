"""Clouds that are fit for numbers with sigmas."""

import numpy as np

from jaxscan.errors import MeasurementError
from jaxscan.measurement.samples import Cloud, Samples, samples_of


FARTHEST_M = 1e8
"""Largest coordinate of a point [m]: more than twice around the Earth."""


LEAST_KNOWN = 0.2
"""Largest share of itself that the standard deviation of a dimension may have [1]; above it nobody measured it."""


def is_known(value: float, sigma: float) -> bool:
    """Whether a length, an area or a volume is known well enough to be stated as one."""
    # NaN fails too.
    return sigma <= LEAST_KNOWN * value


def require_known(what: str, value_m: float, sigma_m: float) -> None:
    """Refuse to state a length that is not known.

    Raises:
        MeasurementError: If its standard deviation is too large a share of it.
    """
    if not is_known(value_m, sigma_m):
        raise MeasurementError(
            f"The {what} is not known: {1e3 * value_m:.3g} mm with a standard deviation of {1e3 * sigma_m:.3g} mm, "
            f"expected at most {100 * LEAST_KNOWN:.0f} % of it; average more points, or measure something longer."
        )


def checked_samples(cloud: Cloud) -> Samples:
    """All valid points, as `samples_of` gives them.

    Raises:
        MeasurementError: If there are none, or if a coordinate or sigma is no number that a point can have.
    """
    valid = np.asarray(cloud.valid)
    xyz, sigma = np.asarray(cloud.xyz)[valid], np.asarray(cloud.sigma_random)[valid]
    # NaN fails too.
    if not (np.abs(xyz) <= FARTHEST_M).all():
        raise MeasurementError(f"The cloud has coordinates that are not numbers within {FARTHEST_M:g} m of 0.")
    if len(sigma) and not (np.isfinite(sigma).all() and (sigma > 0).any()):
        raise MeasurementError(
            "The cloud has no sigmas, so nobody knows how uncertain a measured number is; a cloud of jaxscan "
            "reconstruct is needed, as .ply or .npz."
        )
    return samples_of(cloud)
