"""Estimator ``sqrf``: Carlson's triangular square root (numba)."""

from __future__ import annotations

from stcal.estimators.filter_kernels import carlson_update
from stcal.estimators.pointer_kernels import UPDATE, single
from stcal.estimators.root_kernels import covariance_of, predict_double, predict_single
from stcal.jit import pointer

__all__ = ["covariance_of", "predict_double", "predict_single", "update_double", "update_single"]


@pointer(UPDATE)
def update_double(rows, values, x, root, innovation, score):
    """Carlson's square-root update."""
    carlson_update(rows, x, root, innovation, score)


@pointer(UPDATE)
def update_single(rows, values, x, root, innovation, score):
    """Carlson's square-root update in single precision."""
    x4, root4, z4, score4 = single(x), single(root), single(innovation), single(score)
    carlson_update(single(rows), x4, root4, z4, score4)
    x[:], root[:, :], innovation[:], score[:] = x4, root4, z4, score4
