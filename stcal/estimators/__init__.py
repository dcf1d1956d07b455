"""Estimators: from whitened residuals to parameters with their covariance."""
