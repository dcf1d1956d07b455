"""Estimator ``ukf``: unscented, in square-root form (numba)."""

from __future__ import annotations

from stcal.estimators.filter_kernels import unscented_update
from stcal.estimators.pointer_kernels import UPDATE, single
from stcal.estimators.root_kernels import covariance_of, predict_double, predict_single
from stcal.jit import pointer

__all__ = ["covariance_of", "predict_double", "predict_single", "update_double", "update_single"]


@pointer(UPDATE)
def update_double(rows, values, x, root, innovation, score):
    """Unscented update."""
    unscented_update(values, x, root, innovation, score)


@pointer(UPDATE)
def update_single(rows, values, x, root, innovation, score):
    """Unscented update in single precision."""
    x4, root4, z4, score4 = single(x), single(root), single(innovation), single(score)
    unscented_update(single(values), x4, root4, z4, score4)
    x[:], root[:, :], innovation[:], score[:] = x4, root4, z4, score4
