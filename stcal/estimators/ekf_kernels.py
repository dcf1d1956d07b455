"""Estimator ``ekf``: the conventional filter, its root the covariance itself (numba)."""

from __future__ import annotations

from stcal.estimators.filter_kernels import conventional_predict, conventional_update
from stcal.estimators.pointer_kernels import COVARIANCE, PREDICT, UPDATE, single
from stcal.jit import pointer


@pointer(UPDATE)
def update_double(rows, values, x, root, innovation, score):
    """Conventional Kalman update."""
    conventional_update(rows, x, root, innovation, score)


@pointer(UPDATE)
def update_single(rows, values, x, root, innovation, score):
    """Conventional Kalman update in single precision."""
    x4, root4, z4, score4 = single(x), single(root), single(innovation), single(score)
    conventional_update(single(rows), x4, root4, z4, score4)
    x[:], root[:, :], innovation[:], score[:] = x4, root4, z4, score4


@pointer(PREDICT)
def predict_double(root, noise_sd):
    """Add process noise to a covariance."""
    conventional_predict(root, noise_sd)


@pointer(PREDICT)
def predict_single(root, noise_sd):
    """Add process noise to a covariance in single precision."""
    root4 = single(root)
    conventional_predict(root4, single(noise_sd))
    root[:, :] = root4


@pointer(COVARIANCE)
def covariance_of(root, covariance):
    """The conventional filter's root is the covariance."""
    covariance[:, :] = root
