"""How a stripe's centre is found on a line."""

from jaxscan.stripes.estimators.estimator import Estimator
from jaxscan.stripes.estimators.registry import ESTIMATORS, estimator_of
