"""One fit by any combination of residual and estimator, from given matches.

The same steps as the commands ``fit --batch`` and ``fit --sequential`` take, without identification
and gates: the frames come with their stars.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.calibration import Calibration
from stcal.cameras import Camera
from stcal.errors import StcalError
from stcal.estimators.batch import covariance_from
from stcal.estimators.sequential import SEQUENTIAL
from stcal.execution import serial
from stcal.frames import MatchedFrames
from stcal.matching import Matcher
from stcal.pipeline.filter_run import run_filter
from stcal.pipeline.filtering import Variant, make_filter
from stcal.pipeline.fitting import Fitting, fit_camera
from stcal.pipeline.identifying import Identify
from stcal.pipeline.parameters import parameter_scale
from stcal.pipeline.pieces import pieces_of
from stcal.pipeline.scratch import MemoryScratch
from stcal.residuals import BoundResidual, Residual

Floats = NDArray[np.float64]

BATCH = "batch"
ESTIMATORS = (BATCH, *SEQUENTIAL)
RESIDUALS: dict[str, Residual] = {
    "direction": Residual("direction"),
    "arclength": Residual("arclength"),
    "singular-values": Residual("singular-values", 4, (2, 3)),
    "cosine": Residual("cosine"),
}
# As the batch fit: outliers are judged anew after each fit.
_REJECTION_ROUNDS = 5


@dataclass(frozen=True)
class Fitted:
    """What a fit makes of given matches.

    Attributes
    ----------
    parameters, sd : (P,) of the camera, and the reported sd
    seconds : of this thread
    kept_bytes : what must be kept from frame to frame: by a batch fit the stars of all frames, what
        the residual makes of them and its derivatives, by a filter its state with the latest frames
    """

    parameters: Floats
    sd: Floats
    seconds: float
    kept_bytes: int


def fit_given(
    given: MatchedFrames,
    initial: Camera,
    matcher: Matcher,
    residual: Residual,
    estimator: str,
) -> Fitted | None:
    """Fit the camera by one combination; None when that fails.

    Parameters
    ----------
    given : frames with their matches, attitudes solved with ``initial``
    initial : where the fit starts
    matcher : the catalogue's, and the sensor's configuration
    residual, estimator : the combination; the estimator is one of ESTIMATORS
    """
    one = _batch if estimator == BATCH else partial(_sequential, estimator)
    began = time.thread_time()
    try:
        parameters, covariance, kept_bytes = one(given, initial, matcher, residual)
    except (StcalError, np.linalg.LinAlgError):
        return None
    seconds = time.thread_time() - began
    sd = np.sqrt(np.diag(covariance))
    if not (np.isfinite(parameters).all() and np.isfinite(sd).all()):
        return None
    return Fitted(parameters, sd, seconds, kept_bytes)


_Result = tuple[Floats, Floats, int]


def _batch(given: MatchedFrames, initial: Camera, matcher: Matcher, residual: Residual) -> _Result:
    """Fit all frames at once, leaving out outliers until they settle."""
    config, scratch = matcher.config, MemoryScratch()
    scale = parameter_scale(config, initial.parameter_names)
    free, (piece,) = np.arange(len(scale)), pieces_of([given.frames])
    identify = Identify(scratch, matcher, initial, np.eye(3), "given", "telemetry", None, 1)
    departures = identify.keep(piece, given).departures
    fitting = Fitting(scratch, "given", config, residual, free)
    fitted = fit_camera(fitting, [piece], initial, departures, serial)
    camera, solution = fitted.camera, fitted.solution
    bound = residual.bind(fitted.fitting.kept_stars(piece), camera)
    if not solution.converged:
        raise StcalError(f"the batch fit did not converge in {solution.iterations} steps")
    noise = solution.chi2 / (solution.information.rows - len(free))
    covariance = covariance_from(solution.information) * np.outer(scale, scale) * noise
    return camera.parameters, covariance, _bound_bytes(bound, len(scale))


def _sequential(
    method: str, given: MatchedFrames, initial: Camera, matcher: Matcher, residual: Residual
) -> _Result:
    """Run a filter over the frames; constants, as the simulated camera's parameters are."""
    calibration = Calibration(given.frames.sensor_id, 1, initial, np.eye(3))
    variant = Variant(method=method, residual=residual, rematch=False, shadow=False)
    chosen = make_filter(variant, calibration, matcher)
    run = run_filter(chosen, [given], chosen.start)
    scale = chosen.model.scale
    covariance = chosen.covariance(run.state) * np.outer(scale, scale)
    return run.camera_parameters, covariance, _array_bytes(run.state)


def _bound_bytes(bound: BoundResidual, parameters: int) -> int:
    rows = bound.size * (parameters + 1) * np.dtype(np.float64).itemsize
    held = sum(_array_bytes(item) for item in (bound, bound.selection, *bound.blocks))
    return held + rows


def _array_bytes(item: Any) -> int:
    """Return the bytes of the arrays among a dataclass's fields."""
    values = [getattr(item, field.name) for field in fields(item)]
    return sum(value.nbytes for value in values if isinstance(value, np.ndarray))
