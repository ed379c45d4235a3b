"""The joint least squares: problem, residuals, solver, covariance."""

from jaxscan.calibration.solve.adjust import adjust, adjust_further, not_converged
from jaxscan.calibration.solve.adjustment import Adjustment
from jaxscan.calibration.solve.covariance import Determination, determine, undetermined_shares
from jaxscan.calibration.solve.prepare import Prepared, prepare
from jaxscan.calibration.solve.problem import bend_of, make_problem, with_modes
