"""How a stripe's centre is found on a line."""

from jaxscan.stripes.estimators.estimator import Estimator as Estimator
from jaxscan.stripes.estimators.registry import ESTIMATORS as ESTIMATORS
from jaxscan.stripes.estimators.registry import estimator_of as estimator_of
