"""The joint least squares: problem, residuals, solver, covariance."""
