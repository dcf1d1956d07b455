"""What follows from a solution, whichever estimator found it: observability, alignment, RMS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from stcal.calibration import Calibration
from stcal.cameras import Camera
from stcal.constants import EXPOSURES_PER_FRAME
from stcal.estimators.batch import Observability, observability
from stcal.estimators.information import SquareRootInformation
from stcal.execution import OrderedMap
from stcal.frames import MatchedFrames
from stcal.matching import Matcher
from stcal.matching.identify import rematch_given
from stcal.metrics import coverage, pair_sums
from stcal.pipeline.alignment import Alignment, update_alignment
from stcal.pipeline.parameters import parameter_scale
from stcal.residuals import BoundArclength, Residual

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Solution:
    """What an estimator hands over.

    Attributes
    ----------
    matched, bound : the final matches and their arclengths, fragment by fragment
    camera : the fitted camera
    free : (K,) places of the estimated parameters, rising
    information : factor of the residuals at the fitted camera, in scaled estimated parameters
    residual : what was fitted
    dependent : residuals that carried nothing new
    covariance : (P, P) of the camera's parameters in their own units, zero for those held fixed
    noise_scale : sd of the residuals over the noise model
    rejected : stars left out as outliers
    """

    matched: list[MatchedFrames]
    bound: list[BoundArclength]
    camera: Camera
    free: Ints
    information: SquareRootInformation
    residual: Residual
    dependent: int
    covariance: Floats
    noise_scale: float
    rejected: int

    @property
    def estimated_names(self) -> list[str]:
        """Names of the estimated parameters."""
        return [self.camera.parameter_names[k] for k in self.free]

    @property
    def matched_stars(self) -> int:
        """Number of matched stars."""
        return sum(int(m.is_matched.sum()) for m in self.matched)


@dataclass(frozen=True)
class Estimate:
    """A solution with what follows from it; ``baseline`` is what the initial calibration sees."""

    solution: Solution
    observed: Observability
    alignment: Alignment | None
    baseline: list[MatchedFrames]
    coverage: float
    rms_initial: float
    rms_fitted: float


def estimate_of(
    solution: Solution,
    initial: Calibration,
    baseline: list[MatchedFrames],
    matcher: Matcher,
    mapper: OrderedMap,
) -> Estimate:
    """Derive observability, alignment, coverage and RMS from a solution."""
    scale = parameter_scale(matcher.config, solution.estimated_names)
    # The last matches were made with the camera before; their attitudes under the fitted one.
    resolve = partial(_solve_again, camera=solution.camera, matcher=matcher)
    fitted = list(mapper(resolve, solution.matched))
    before, after = _common_rms(solution, initial)
    rows, cols = _used_centroids(solution)
    return Estimate(
        solution=solution,
        observed=observability(solution.information, scale),
        alignment=update_alignment(initial.c_sd, _attitudes(baseline), _attitudes(fitted)),
        baseline=baseline,
        coverage=coverage(rows, cols, solution.camera),
        rms_initial=before,
        rms_fitted=after,
    )


def _solve_again(matched: MatchedFrames, camera: Camera, matcher: Matcher) -> MatchedFrames:
    return rematch_given(matched.frames, camera, matcher.catalogue, matched.star)


def _attitudes(matched: Sequence[MatchedFrames]) -> Floats:
    return np.concatenate([m.c_di for m in matched])


def _common_rms(solution: Solution, initial: Calibration) -> tuple[float, float]:
    """RMS arclength error [rad] of the fit's own arcs under the initial and the fitted camera."""
    squares, pairs = np.zeros(2), 0
    for bound, matched in zip(solution.bound, solution.matched, strict=True):
        frame = matched.frames.exposure_of_star // EXPOSURES_PER_FRAME
        for k, camera in enumerate((initial.camera, solution.camera)):
            sums = pair_sums(bound, frame, matched.frames.n_frames, camera)
            squares[k] += sums.squares.sum()
        pairs += int(sums.pairs.sum())
    before, after = np.sqrt(squares / pairs) if pairs else (np.nan, np.nan)
    return float(before), float(after)


def _used_centroids(solution: Solution) -> tuple[Floats, Floats]:
    selections = [bound.selection for bound in solution.bound]
    return (
        np.concatenate([s.row_px for s in selections]),
        np.concatenate([s.col_px for s in selections]),
    )
