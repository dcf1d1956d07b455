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
from stcal.execution import OrderedMap, serial
from stcal.frames import FrameBatch
from stcal.matching import Matcher
from stcal.pipeline import describe
from stcal.pipeline.cycles import Cycle
from stcal.pipeline.estimate import estimate_camera
from stcal.pipeline.gates import fit_refusals

Floats = NDArray[np.float64]


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
    mapper : ordered map over the fragments
    on_cycle : told about each finished cycle
    """
    batches = [batch for batch in batches if batch.n_frames]
    check_calibration(initial, matcher.config, batches[0].sensor_id)
    estimate = estimate_camera(batches, initial, matcher, matches, mapper, on_cycle)
    refusals = fit_refusals(estimate, batches, initial, matcher.config)
    document = describe.fit_document(
        estimate, batches, initial, matcher, refusals, provenance, matches
    )
    calibration = None
    if not refusals and estimate.alignment is not None:
        calibration = replace(
            initial,
            serial=initial.serial + 1,
            camera=estimate.last.camera,
            c_sd=estimate.alignment.c_sd,
            covariance=estimate.covariance,
            provenance=provenance,
            quality=describe.quality(document),
        )
    return FitResult(calibration, document)


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
