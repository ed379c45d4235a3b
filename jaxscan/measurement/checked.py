"""Clouds that are fit for numbers with sigmas."""

from collections.abc import Iterator

import numpy as np

from jaxscan.errors import MeasurementError
from jaxscan.measurement.samples import AT_ONCE, Cloud, CloudSamples


FARTHEST_M = 1e8
"""Largest coordinate of a point [m]: more than twice around the Earth."""


LEAST_KNOWN = 0.2
"""Largest relative standard deviation of a dimension [1]; above it the dimension counts as not measured."""


def is_known(value: float, sigma: float) -> bool:
    """Whether a length, an area or a volume is known well enough to be stated."""
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


def checked_samples(cloud: Cloud) -> CloudSamples:
    """All valid points.

    Raises:
        MeasurementError: If there are none, or if a coordinate or sigma is no number that a point can have.
    """
    samples = CloudSamples(cloud)
    finite, known = True, False
    valid = np.asarray(cloud.valid)
    # Profile by profile, or a part of a long one: only that is copied.
    for xyz, sigma, seen in _parts(np.asarray(cloud.xyz), np.asarray(cloud.sigma_random), valid):
        # NaN fails too.
        if not (np.abs(xyz[seen]) <= FARTHEST_M).all():
            raise MeasurementError(f"The cloud has coordinates that are not numbers within {FARTHEST_M:g} m of 0.")
        finite &= bool(np.isfinite(sigma[seen]).all())
        known |= bool((sigma[seen] > 0).any())
    if not (finite and known):
        raise MeasurementError(
            "The cloud has no sigmas, so nobody knows how uncertain a measured number is; a cloud of jaxscan "
            "reconstruct is needed, as .ply or .npz."
        )
    return samples


def _parts(*fields: np.ndarray) -> Iterator[tuple[np.ndarray, ...]]:
    flat = [field.reshape(-1, *field.shape[2:]) for field in fields]
    for start in range(0, len(flat[0]), AT_ONCE):
        yield tuple(field[start : start + AT_ONCE] for field in flat)
