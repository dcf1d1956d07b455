"""What the estimators share whose root is S^T, P = S S^T: time update and covariance (numba)."""

from __future__ import annotations

from stcal.estimators.filter_kernels import root_predict
from stcal.estimators.pointer_kernels import COVARIANCE, PREDICT, single
from stcal.jit import pointer


@pointer(PREDICT)
def predict_double(root, noise_sd):
    """Add process noise to a square root."""
    root_predict(root, noise_sd)


@pointer(PREDICT)
def predict_single(root, noise_sd):
    """Add process noise to a square root in single precision."""
    root4 = single(root)
    root_predict(root4, single(noise_sd))
    root[:, :] = root4


@pointer(COVARIANCE)
def covariance_of(root, covariance):
    """P = S S^T with S^T the root."""
    n = root.shape[0]
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(min(i, j) + 1):
                total += root[k, i] * root[k, j]
            covariance[i, j] = total
