"""Least squares of shared unknowns and of blocks that are eliminated, iterated by optimistix."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.geometry import MEDIAN_TO_SIGMA
    from jaxscan.leastsq.arrow import (
        AbstractProblem,
        Arrow,
        Covariance,
        Linear,
        Normal,
        Unknowns,
        covariance_of,
        reduce_arrow,
        solve_arrow,
        sum_arrow,
        undetermined,
    )
    from jaxscan.leastsq.fit import Fit, Group, Prior, fit, minimised
    from jaxscan.leastsq.robust import Cauchy, Huber, Loss, chance_of, keep_inliers, noise_component, robust_noise
else:
    load_on_use(__name__)
