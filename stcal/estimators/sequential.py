"""Sequential estimators by name: frame after frame, as they would run on the sensor.

Enright 2018 section II-D and Appendix C.  Each is a set of pure steps on a state and a square root
of its own kind; the steps are compiled function pointers (``pointer_kernels``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.estimators import pointer_kernels as steps

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Steps:
    """The compiled steps of an estimator in one precision."""

    update: Any
    predict: Any


@dataclass(frozen=True)
class SequentialEstimator:
    """One sequential estimator.

    Attributes
    ----------
    description : one line for users
    root : (n,) initial sd -> (n, n) root
    covariance : compiled, root -> covariance (n, n)
    steps : compiled steps by precision: ``double`` and, where it makes sense, ``single``
    unscented : evaluates residuals at sigma points instead of linearising them
    constant : takes parameters as constants: no process noise, and passes are repeated
    """

    description: str
    root: Callable[[Floats], Floats]
    covariance: Any
    steps: dict[str, Steps]
    unscented: bool = False
    constant: bool = False


SEQUENTIAL: dict[str, SequentialEstimator] = {
    "ekf": SequentialEstimator(
        "extended Kalman filter with the covariance itself",
        lambda sd: np.diag(sd * sd),
        steps.covariance_itself,
        {
            "double": Steps(steps.ekf_double, steps.predict_covariance),
            "single": Steps(steps.ekf_single, steps.predict_covariance_single),
        },
    ),
    "sqrf": SequentialEstimator(
        "Carlson's triangular square-root filter",
        np.diag,
        steps.covariance_of_root,
        {
            "double": Steps(steps.sqrf_double, steps.predict_root),
            "single": Steps(steps.sqrf_single, steps.predict_root_single),
        },
    ),
    "ukf": SequentialEstimator(
        "unscented filter in square-root form",
        np.diag,
        steps.covariance_of_root,
        {
            "double": Steps(steps.ukf_double, steps.predict_root),
            "single": Steps(steps.ukf_single, steps.predict_root_single),
        },
        unscented=True,
    ),
    "smoother": SequentialEstimator(
        "square-root information smoother of constant parameters, the reference",
        lambda sd: np.diag(1.0 / sd),
        steps.covariance_of_information,
        {"double": Steps(steps.smoother_double, steps.predict_constant)},
        constant=True,
    ),
}
