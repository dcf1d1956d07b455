"""The numbers of a fit: cycles, covariance, observability, alignment and RMS."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from stcal.calibration import Calibration
from stcal.cameras import Camera
from stcal.constants import EXPOSURES_PER_FRAME
from stcal.estimators.batch import Observability, covariance_from, observability
from stcal.execution import OrderedMap
from stcal.frames import FrameBatch, MatchedFrames
from stcal.matching import Matcher, match
from stcal.matching.identify import rematch_given
from stcal.metrics import coverage, pair_sums
from stcal.pipeline.alignment import Alignment, update_alignment
from stcal.pipeline.cycles import Cycle, parameter_scale, run_cycles

Floats = NDArray[np.float64]


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
