"""Sequential estimators by name: frame after frame, as they would run on the sensor.

Enright 2018 section II-D and Appendix C.  Each is a set of pure steps on a state and a square root
of its own kind; the steps are compiled function pointers (``pointer_kernels``), one module an
estimator, which is compiled when its steps are asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
    module : where its compiled steps are
    precisions : of its arithmetic: ``double`` and, where it makes sense, ``single``
    unscented : evaluates residuals at sigma points instead of linearising them
    constant : takes parameters as constants: no process noise, and passes are repeated
    """

    description: str
    root: Callable[[Floats], Floats]
    module: str
    precisions: tuple[str, ...] = ("double", "single")
    unscented: bool = False
    constant: bool = False

    @property
    def steps(self) -> dict[str, Steps]:
        """Compiled steps by precision."""
        kernels = import_module(self.module)
        return {
            name: Steps(getattr(kernels, f"update_{name}"), getattr(kernels, f"predict_{name}"))
            for name in self.precisions
        }

    @property
    def covariance(self) -> Any:
        """Compiled, root -> covariance (n, n)."""
        return import_module(self.module).covariance_of


SEQUENTIAL: dict[str, SequentialEstimator] = {
    "ekf": SequentialEstimator(
        "extended Kalman filter with the covariance itself",
        lambda sd: np.diag(sd * sd),
        "stcal.estimators.ekf_kernels",
    ),
    "sqrf": SequentialEstimator(
        "Carlson's triangular square-root filter",
        np.diag,
        "stcal.estimators.sqrf_kernels",
    ),
    "ukf": SequentialEstimator(
        "unscented filter in square-root form",
        np.diag,
        "stcal.estimators.ukf_kernels",
        unscented=True,
    ),
    "smoother": SequentialEstimator(
        "square-root information smoother of constant parameters, the reference",
        lambda sd: np.diag(1.0 / sd),
        "stcal.estimators.smoother_kernels",
        precisions=("double",),
        constant=True,
    ),
}
