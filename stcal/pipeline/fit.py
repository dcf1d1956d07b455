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
from stcal.frames import Fragment
from stcal.matching import Matcher
from stcal.pipeline import describe
from stcal.pipeline.cycles import Cycle, run_cycles
from stcal.pipeline.estimate import Estimate, Solution, estimate_of
from stcal.pipeline.gates import batch_refusals
from stcal.pipeline.identifying import Identified, Identify, series_step
from stcal.pipeline.parameters import embedded, estimated_indices, parameter_scale
from stcal.pipeline.pieces import Piece, pieces_of
from stcal.pipeline.scratch import MemoryScratch, Scratch
from stcal.pipeline.sums import total
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
    fragments: Sequence[Fragment],
    initial: Calibration,
    matcher: Matcher,
    provenance: dict[str, Any],
    matches: str = "lost-in-space",
    parameters: Sequence[str] | None = None,
    residual: Residual = ARCLENGTH,
    mapper: OrderedMap = serial,
    scratch: Scratch | None = None,
    on_cycle: Callable[[Cycle], None] = lambda cycle: None,
) -> FitResult:
    """Refit the camera of ``initial`` to telemetry in cycles of rematching.

    Parameters
    ----------
    fragments : the sensor's frames, or handles to them, in time order
    initial : the calibration to start from
    matcher : catalogue and sensor configuration
    provenance : hashes and time span, stored in the calibration and the document
    matches : where the first cycle's matches come from, ``telemetry`` or a matching method
    parameters : the parameters to estimate, all by default; the others keep their initial values
    residual : what the camera is fitted to
    mapper : ordered map over the fragments
    scratch : where each fragment's arrays wait between passes; in memory by default
    on_cycle : told about each finished cycle
    """
    pieces = pieces_of(fragments)
    check_calibration(initial, matcher.config, pieces[0].fragment.sensor_id)
    residual.check()
    free = estimated_indices(parameters, initial.camera.parameter_names)
    scratch = MemoryScratch() if scratch is None else scratch
    cycles, settled = run_cycles(
        pieces, initial, matcher, matches, residual, free, scratch, mapper, on_cycle
    )
    baseline = _baseline(pieces, initial, matcher, cycles[0], scratch, mapper)
    solution = _solution(cycles[-1])
    estimate = estimate_of(
        solution, cycles[-1].fitted.fitting, pieces, initial, baseline, matcher, mapper
    )
    refusals = batch_refusals(estimate, cycles, settled, initial, matcher.config)
    document = describe.batch_document(
        estimate, cycles, settled, pieces, initial, matcher, refusals, provenance, matches
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


def _solution(cycle: Cycle) -> Solution:
    """Return the last cycle as a solution; the noise that the residuals show scales its sd."""
    fitted = cycle.fitted
    fitting, free = fitted.fitting, fitted.fitting.free
    scale = parameter_scale(fitting.config, fitted.camera.parameter_names)[free]
    try:
        covariance = covariance_from(fitted.solution.information)
    except np.linalg.LinAlgError:
        covariance = np.full((len(free), len(free)), np.nan)
    covariance = covariance * np.outer(scale, scale) * cycle.noise_scale**2
    return Solution(
        identified=cycle.identified,
        kept=fitted.kept,
        camera=fitted.camera,
        free=free,
        information=fitted.solution.information,
        residual=fitting.residual,
        covariance=embedded(covariance, free, len(fitted.camera.parameters)),
        noise_scale=cycle.noise_scale,
    )


def _baseline(
    pieces: Sequence[Piece],
    initial: Calibration,
    matcher: Matcher,
    first: Cycle,
    scratch: Scratch,
    mapper: OrderedMap,
) -> tuple[str, Identified]:
    """Return the cycle of what the initial calibration identifies, and its numbers.

    Telemetered matches are the sensor's own; they are identified anew, so that before and after
    come from the same matcher.
    """
    if first.matching != "telemetry":
        return first.name, first.identified
    identify = Identify(
        scratch, matcher, initial.camera, initial.c_sd, "baseline", "lost-in-space", None,
        series_step(pieces),
    )  # fmt: skip
    return "baseline", total(mapper(identify, pieces))


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
