"""The sequential estimators as function pointers, in double and in single precision (numba).

One signature for all, so that a pass over frames is compiled once.  In single precision the state,
the root and the measurement are rounded on the way in and all arithmetic is single, as on an
embedded processor; what goes out is held in doubles without loss.
"""

from __future__ import annotations

import numpy as np
from numba import float64, void

from stcal.estimators.filter_kernels import (
    carlson_update,
    conventional_predict,
    conventional_update,
    information_update,
    root_predict,
    unscented_update,
)
from stcal.jit import kernel, pointer

_COLUMN, _TABLE = float64[::1], float64[:, ::1]
# rows (A, n + 1), values (A, K), x (n,), root (n, n), innovation (A,), score (2,)
UPDATE = void(_TABLE, _TABLE, _COLUMN, _TABLE, _COLUMN, _COLUMN)
# root (n, n), noise_sd (n,)
PREDICT = void(_TABLE, _COLUMN)
# root (n, n), covariance (n, n)
COVARIANCE = void(_TABLE, _TABLE)


@pointer(UPDATE)
def ekf_double(rows, values, x, root, innovation, score):
    """Conventional Kalman update."""
    conventional_update(rows, x, root, innovation, score)


@pointer(UPDATE)
def sqrf_double(rows, values, x, root, innovation, score):
    """Carlson's square-root update."""
    carlson_update(rows, x, root, innovation, score)


@pointer(UPDATE)
def ukf_double(rows, values, x, root, innovation, score):
    """Unscented update."""
    unscented_update(values, x, root, innovation, score)


@pointer(UPDATE)
def smoother_double(rows, values, x, root, innovation, score):
    """Square-root information update."""
    information_update(rows, x, root, innovation, score)


@kernel
def _single(array):
    return array.astype(np.float32)


@pointer(UPDATE)
def ekf_single(rows, values, x, root, innovation, score):
    """Conventional Kalman update in single precision."""
    x4, root4, z4, score4 = _single(x), _single(root), _single(innovation), _single(score)
    conventional_update(_single(rows), x4, root4, z4, score4)
    x[:], root[:, :], innovation[:], score[:] = x4, root4, z4, score4


@pointer(UPDATE)
def sqrf_single(rows, values, x, root, innovation, score):
    """Carlson's square-root update in single precision."""
    x4, root4, z4, score4 = _single(x), _single(root), _single(innovation), _single(score)
    carlson_update(_single(rows), x4, root4, z4, score4)
    x[:], root[:, :], innovation[:], score[:] = x4, root4, z4, score4


@pointer(UPDATE)
def ukf_single(rows, values, x, root, innovation, score):
    """Unscented update in single precision."""
    x4, root4, z4, score4 = _single(x), _single(root), _single(innovation), _single(score)
    unscented_update(_single(values), x4, root4, z4, score4)
    x[:], root[:, :], innovation[:], score[:] = x4, root4, z4, score4


@pointer(PREDICT)
def predict_covariance(root, noise_sd):
    """Add process noise to a covariance."""
    conventional_predict(root, noise_sd)


@pointer(PREDICT)
def predict_root(root, noise_sd):
    """Add process noise to a square root."""
    root_predict(root, noise_sd)


@pointer(PREDICT)
def predict_covariance_single(root, noise_sd):
    """Add process noise to a covariance in single precision."""
    root4 = _single(root)
    conventional_predict(root4, _single(noise_sd))
    root[:, :] = root4


@pointer(PREDICT)
def predict_root_single(root, noise_sd):
    """Add process noise to a square root in single precision."""
    root4 = _single(root)
    root_predict(root4, _single(noise_sd))
    root[:, :] = root4


@pointer(PREDICT)
def predict_constant(root, noise_sd):
    """Parameters that are constants need no time update."""


@pointer(COVARIANCE)
def covariance_itself(root, covariance):
    """The conventional filter's root is the covariance."""
    covariance[:, :] = root


@pointer(COVARIANCE)
def covariance_of_root(root, covariance):
    """P = S S^T with S^T the root."""
    n = root.shape[0]
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(min(i, j) + 1):
                total += root[k, i] * root[k, j]
            covariance[i, j] = total


@pointer(COVARIANCE)
def covariance_of_information(root, covariance):
    """P = R^-1 R^-T."""
    n = root.shape[0]
    inverse = np.zeros((n, n))
    for k in range(n):
        inverse[k, k] = 1.0 / root[k, k]
        for i in range(k - 1, -1, -1):
            total = 0.0
            for j in range(i + 1, k + 1):
                total += root[i, j] * inverse[j, k]
            inverse[i, k] = -total / root[i, i]
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(max(i, j), n):
                total += inverse[i, k] * inverse[j, k]
            covariance[i, j] = total
