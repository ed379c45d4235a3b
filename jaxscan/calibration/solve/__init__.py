"""The joint least squares: problem, residuals, solver, covariance."""

from jaxscan.calibration.solve.adjust import Adjustment as Adjustment
from jaxscan.calibration.solve.adjust import adjust as adjust
from jaxscan.calibration.solve.adjust import not_converged as not_converged
from jaxscan.calibration.solve.assemble import carrying as carrying
from jaxscan.calibration.solve.assemble import make_problem as make_problem
from jaxscan.calibration.solve.covariance import Determination as Determination
from jaxscan.calibration.solve.covariance import determine as determine
from jaxscan.calibration.solve.prepare import Prepared as Prepared
from jaxscan.calibration.solve.prepare import prepare as prepare
