"""Least squares of shared unknowns and of blocks that are eliminated, iterated by optimistix."""

from jaxscan.leastsq.arrow import Arrow, Covariance, covariance_of, reduce_arrow, solve_arrow
from jaxscan.leastsq.problem import AbstractProblem, Group, Linear, Normal, Prior, Unknowns, sum_arrow
from jaxscan.leastsq.robust import Cauchy, Huber, Loss, keep_inliers, noise_component, robust_noise
