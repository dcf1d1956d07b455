"""Stage ``fit --batch``: refit the camera, update C_SD, judge, and describe the result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.calibration import Calibration
from stcal.cameras import Camera
from stcal.config import SensorConfig
from stcal.constants import ARCSEC, EXPOSURES_PER_FRAME
from stcal.errors import GateRefusalError, InputError
from stcal.estimators.batch import Observability, covariance_from, observability
from stcal.execution import OrderedMap, serial
from stcal.frames import FrameBatch, MatchedFrames
from stcal.matching import Matcher, match
from stcal.matching.identify import rematch_given
from stcal.metrics import coverage, pair_sums
from stcal.pipeline import describe
from stcal.pipeline.alignment import Alignment, update_alignment
from stcal.pipeline.cycles import Cycle, run_cycles
from stcal.pipeline.gates import fit_refusals

Floats = NDArray[np.float64]

SCHEMA = "stcal.fit/1"


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


@dataclass(frozen=True)
class Estimate:
    """The numbers behind the document: the last cycle's solution in physical units."""

    cycles: list[Cycle]
    settled: bool
    covariance: Floats
    observed: Observability
    alignment: Alignment | None
    baseline: list[MatchedFrames]
    coverage: float
    rms_initial: float
    rms_fitted: float

    @property
    def last(self) -> Cycle:
        """The final cycle."""
        return self.cycles[-1]

    @property
    def change_in_last_cycle_sd(self) -> float:
        """Largest change of a parameter by the last cycle, in sd; infinite after one cycle."""
        if len(self.cycles) < 2:
            return float("inf")
        before, after = (c.camera.parameters for c in self.cycles[-2:])
        with np.errstate(divide="ignore", invalid="ignore"):
            return float(np.max(np.abs(after - before) / np.sqrt(np.diag(self.covariance))))


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
    matches : where the first cycle's matches come from (``cycles.FIRST_MATCHES``)
    mapper : ordered map over the fragments
    on_cycle : told about each finished cycle
    """
    check_detector(initial, matcher.config)
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


def estimate_camera(
    batches: Sequence[FrameBatch],
    initial: Calibration,
    matcher: Matcher,
    matches: str,
    mapper: OrderedMap,
    on_cycle: Callable[[Cycle], None],
) -> Estimate:
    """Run the cycles and derive covariance, observability, alignment and RMS."""
    cycles, settled = run_cycles(batches, initial, matcher, matches, mapper, on_cycle)
    last = cycles[-1]
    scale = parameter_scale(matcher.config, last.camera.parameter_names)
    observed = observability(last.solution.information, scale)
    baseline = _baseline(batches, initial, matcher, cycles[0], mapper)
    # The last matches were made with the camera before; their attitudes under the fitted one.
    resolve = partial(_solve_again, camera=last.camera, matcher=matcher)
    fitted = list(mapper(resolve, last.matched))
    before, after = _common_rms(last, initial)
    rows, cols = _used_centroids(last)
    return Estimate(
        cycles=cycles,
        settled=settled,
        covariance=_covariance(last, scale),
        observed=observed,
        alignment=update_alignment(initial.c_sd, _attitudes(baseline), _attitudes(fitted)),
        baseline=baseline,
        coverage=coverage(rows, cols, last.camera),
        rms_initial=before,
        rms_fitted=after,
    )


def parameter_scale(config: SensorConfig, names: Sequence[str]) -> Floats:
    """Return Table II's sigma (P,) of each parameter."""
    return np.array([config.camera.scale[name].sigma for name in names])


def check_detector(calibration: Calibration, config: SensorConfig) -> None:
    """Refuse a calibration that belongs to another camera than the configuration's."""
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
    if not config.applies_to(calibration.sensor_id):
        problems.append(f"sensor {calibration.sensor_id}, not {' or '.join(config.sensor_ids)}")
    if problems:
        raise InputError(
            f"the calibration of {calibration.sensor_id} does not fit the configuration "
            f"{config.name!r}: " + "; ".join(problems)
        )


def _covariance(cycle: Cycle, scale: Floats) -> Floats:
    """Covariance in the parameters' units, scaled by the noise that the residuals show."""
    try:
        covariance = covariance_from(cycle.solution.information)
    except np.linalg.LinAlgError:
        return np.full((len(scale), len(scale)), np.nan)
    return np.asarray(covariance * np.outer(scale, scale) * cycle.noise_scale**2)


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


def _solve_again(matched: MatchedFrames, camera: Camera, matcher: Matcher) -> MatchedFrames:
    return rematch_given(matched.frames, camera, matcher.catalogue, matched.star)


def _attitudes(matched: Sequence[MatchedFrames]) -> Floats:
    return np.concatenate([m.c_di for m in matched])


def _common_rms(cycle: Cycle, initial: Calibration) -> tuple[float, float]:
    """RMS arclength error [rad] of the fit's own arcs under the initial and the fitted camera."""
    squares, pairs = np.zeros(2), 0
    for bound, matched in zip(cycle.bound, cycle.matched, strict=True):
        frame = matched.frames.exposure_of_star // EXPOSURES_PER_FRAME
        for k, camera in enumerate((initial.camera, cycle.camera)):
            sums = pair_sums(bound, frame, matched.frames.n_frames, camera)
            squares[k] += sums.squares.sum()
        pairs += int(sums.pairs.sum())
    before, after = np.sqrt(squares / pairs) if pairs else (np.nan, np.nan)
    return float(before), float(after)


def _used_centroids(cycle: Cycle) -> tuple[Floats, Floats]:
    selections = [bound.selection for bound in cycle.bound]
    return (
        np.concatenate([s.row_px for s in selections]),
        np.concatenate([s.col_px for s in selections]),
    )


def refusal_of(document: dict[str, Any]) -> GateRefusalError:
    """Return the exception that ends a refused command, with the document for ``--json``."""
    error = GateRefusalError("refused: " + "; ".join(document["verdict"]["reasons"]))
    error.document = document
    return error


def arcsec(vector: Floats) -> list[float]:
    """Return a vector in rad as a list in arcsec."""
    return [float(v) for v in vector / ARCSEC]
