"""Stage ``fit --batch``: refit the camera, update C_SD, judge, and describe the result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.calibration import Calibration
from stcal.config import SensorConfig
from stcal.errors import GateRefusalError, InputError
from stcal.estimators.batch import covariance_from
from stcal.execution import OrderedMap, serial
from stcal.frames import FrameBatch, MatchedFrames
from stcal.matching import Matcher, match
from stcal.pipeline import describe
from stcal.pipeline.cycles import Cycle, run_cycles
from stcal.pipeline.estimate import Estimate, Solution, estimate_of
from stcal.pipeline.gates import batch_refusals
from stcal.pipeline.parameters import embedded, estimated_indices, parameter_scale
from stcal.residuals import ARCLENGTH, Residual

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class FitResult:
    """A finished fit: the new calibration, and the document that explains it.

    ``calibration`` is None when a gate refused; the reasons are in ``document["verdict"]``.
    """

    calibration: Calibration | None
    document: dict[str, Any]

    @property
    def accepted(self) -> bool:
        """Whether every gate let the fit pass."""
        return bool(self.document["verdict"]["accepted"])


def fit_batch(
    batches: Sequence[FrameBatch],
    initial: Calibration,
    matcher: Matcher,
    provenance: dict[str, Any],
    matches: str = "lost-in-space",
    parameters: Sequence[str] | None = None,
    residual: Residual = ARCLENGTH,
    mapper: OrderedMap = serial,
    on_cycle: Callable[[Cycle], None] = lambda cycle: None,
) -> FitResult:
    """Refit the camera of ``initial`` to telemetry in cycles of rematching.

    Parameters
    ----------
    batches : the sensor's frames, fragment by fragment in time order
    initial : the calibration to start from
    matcher : catalogue and sensor configuration
    provenance : hashes and time span, stored in the calibration and the document
    matches : where the first cycle's matches come from, ``telemetry`` or a matching method
    parameters : the parameters to estimate, all by default; the others keep their initial values
    residual : what the camera is fitted to
    mapper : ordered map over the fragments
    on_cycle : told about each finished cycle
    """
    batches = [batch for batch in batches if batch.n_frames]
    check_calibration(initial, matcher.config, batches[0].sensor_id)
    residual.check()
    free = estimated_indices(parameters, initial.camera.parameter_names)
    cycles, settled = run_cycles(
        batches, initial, matcher, matches, residual, free, mapper, on_cycle
    )
    baseline = _baseline(batches, initial, matcher, cycles[0], mapper)
    solution = _solution(cycles[-1], matcher.config, residual, free)
    estimate = estimate_of(solution, initial, baseline, matcher, mapper)
    refusals = batch_refusals(estimate, cycles, settled, initial, matcher.config)
    document = describe.batch_document(
        estimate, cycles, settled, batches, initial, matcher, refusals, provenance, matches
    )
    return FitResult(fitted_calibration(estimate, initial, document), document)


def fitted_calibration(
    estimate: Estimate, initial: Calibration, document: dict[str, Any]
) -> Calibration | None:
    """Return the calibration file of a fit, None when a gate refused it."""
    if not document["verdict"]["accepted"] or estimate.alignment is None:
        return None
    return replace(
        initial,
        serial=initial.serial + 1,
        camera=estimate.solution.camera,
        c_sd=estimate.alignment.c_sd,
        covariance=estimate.solution.covariance,
        provenance=document["provenance"],
        quality=describe.quality(document),
    )


def _solution(cycle: Cycle, config: SensorConfig, residual: Residual, free: Ints) -> Solution:
    """Return the last cycle as a solution; the noise that the residuals show scales its sd."""
    scale = parameter_scale(config, cycle.camera.parameter_names)[free]
    try:
        covariance = covariance_from(cycle.solution.information)
    except np.linalg.LinAlgError:
        covariance = np.full((len(free), len(free)), np.nan)
    covariance = covariance * np.outer(scale, scale) * cycle.noise_scale**2
    return Solution(
        matched=cycle.matched,
        bound=cycle.arcs,
        camera=cycle.camera,
        free=free,
        information=cycle.solution.information,
        residual=residual,
        dependent=sum(b.dependent for b in cycle.bound),
        covariance=embedded(covariance, free, len(cycle.camera.parameters)),
        noise_scale=cycle.noise_scale,
        rejected=cycle.rejected,
    )


def _baseline(
    batches: Sequence[FrameBatch],
    initial: Calibration,
    matcher: Matcher,
    first: Cycle,
    mapper: OrderedMap,
) -> list[MatchedFrames]:
    """Return the frames as the initial calibration identifies them.

    Telemetered matches are the sensor's own; they are identified anew, so that before and after
    come from the same matcher.
    """
    if first.matching != "telemetry":
        return first.matched
    return list(mapper(lambda b: match(b, initial.camera, initial.c_sd, matcher), batches))


def check_calibration(calibration: Calibration, config: SensorConfig, sensor_id: str) -> None:
    """Refuse a calibration of another sensor, or of another camera than the configuration's."""
    camera, detector = calibration.camera, config.detector
    problems = []
    if camera.model.name != config.camera.model:
        problems.append(f"camera model {camera.model.name}, not {config.camera.model}")
    if (camera.rows, camera.cols) != (detector.rows, detector.cols):
        problems.append(
            f"detector {camera.rows} x {camera.cols}, not {detector.rows} x {detector.cols}"
        )
    if abs(camera.pixel_size_m / detector.pixel_size_m - 1.0) > 1e-6:
        problems.append(f"pixel size {camera.pixel_size_m} m, not {detector.pixel_size_m} m")
    if calibration.sensor_id != sensor_id:
        problems.append(f"sensor {calibration.sensor_id}, not {sensor_id}")
    if problems:
        where = calibration.origin or f"the calibration of {calibration.sensor_id}"
        raise InputError(f"{where} does not fit {config.name!r}: " + "; ".join(problems))


def refusal_of(document: dict[str, Any]) -> GateRefusalError:
    """Return the exception that ends a refused command, with the document for ``--json``."""
    error = GateRefusalError("refused: " + "; ".join(document["verdict"]["reasons"]))
    error.document = document
    return error
