"""From recordings to a posterior: observations, simulated readings, residuals weighed by noise, a descent."""
