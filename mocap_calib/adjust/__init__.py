"""Bundle adjustment: observations, residuals, solver, covariance."""
