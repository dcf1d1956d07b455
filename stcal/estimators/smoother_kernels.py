"""Estimator ``smoother``: square-root information of constant parameters (numba)."""

from __future__ import annotations

import numpy as np

from stcal.estimators.filter_kernels import information_update
from stcal.estimators.pointer_kernels import COVARIANCE, PREDICT, UPDATE
from stcal.jit import pointer


@pointer(UPDATE)
def update_double(rows, values, x, root, innovation, score):
    """Square-root information update."""
    information_update(rows, x, root, innovation, score)


@pointer(PREDICT)
def predict_double(root, noise_sd):
    """Parameters that are constants need no time update."""


@pointer(COVARIANCE)
def covariance_of(root, covariance):
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
