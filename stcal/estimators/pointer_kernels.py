"""The steps of a sequential estimator as function pointers; single precision (numba).

One signature for all estimators, so that a pass over frames is compiled once.  Each estimator has a
module ``<name>_kernels`` with ``update_double``, ``predict_double`` and ``covariance_of``, and
where it makes sense ``update_single`` and ``predict_single``: there the state, the root and the
measurement are rounded on the way in and all arithmetic is single, as on an embedded processor;
what goes out is held in doubles without loss.
"""

from __future__ import annotations

import numpy as np
from numba import float64, void

from stcal.jit import kernel

_COLUMN, _TABLE = float64[::1], float64[:, ::1]
# rows (A, n + 1), values (A, K), x (n,), root (n, n), innovation (A,), score (2,)
UPDATE = void(_TABLE, _TABLE, _COLUMN, _TABLE, _COLUMN, _COLUMN)
# root (n, n), noise_sd (n,)
PREDICT = void(_TABLE, _COLUMN)
# root (n, n), covariance (n, n)
COVARIANCE = void(_TABLE, _TABLE)


@kernel
def single(array):
    """Return an array rounded to single precision."""
    return array.astype(np.float32)
