"""All estimators, by the names that settings and the command line have for them."""

from jaxscan.stripes.estimators.centre_of_gravity import CentreOfGravity
from jaxscan.stripes.estimators.estimator import Estimator
from jaxscan.stripes.estimators.gaussian import Gaussian
from jaxscan.stripes.stripes import StripeSettings


ESTIMATORS: dict[str, Estimator] = {"gaussian": Gaussian(), "centre_of_gravity": CentreOfGravity()}


def estimator_of(settings: StripeSettings) -> Estimator:
    """The estimator that the settings name.

    Raises:
        ValueError: If there is none of this name, or it cannot choose as the settings ask.
    """
    found = ESTIMATORS.get(settings.estimator)
    if found is None:
        raise ValueError(f"Unknown estimator {settings.estimator!r}; known: {', '.join(ESTIMATORS)}.")
    if settings.choice not in found.choices:
        raise ValueError(
            f'The estimator "{settings.estimator}" cannot choose "{settings.choice}", only '
            f"{', '.join(found.choices)}; take another choice, or another estimator."
        )
    return found
