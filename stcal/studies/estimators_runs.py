"""One run of the study ``estimators``: all combinations on the same frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.frames import MatchedFrames
from stcal.studies.estimators_fits import RESIDUALS, Fitted, fit_given
from stcal.studies.estimators_scene import (
    Sample,
    Scene,
    solved_with,
    take_sample,
    with_false_matches,
)

Floats = NDArray[np.float64]
Pair = tuple[str, str]

# Bad starts: normal errors of so many sigma in every parameter.
STARTS = (4.0, 8.0, 16.0)
# Shares of the matched stars that are another star.
FALSE_SHARES = (0.01, 0.03, 0.1)
_US = 1e6


@dataclass(frozen=True)
class Fit:
    """One fit's figures: rms error of directions over the bound's, rms of error / sd, and cost."""

    over_bound: float
    error_over_sd: float
    us_per_frame: float
    kept_bytes: int


@dataclass(frozen=True)
class Accuracy:
    """All combinations on one run's frames.

    Attributes
    ----------
    stars : matched stars in an exposure
    bound_rad : rms error of directions that the bound allows
    initial_over_bound, efficient_over_bound : of the camera on board, and of the efficient estimate
    efficient_over_sd : the rms of the efficient estimate's errors over the bound's sd
    fits : by residual and estimator, those that have a result
    """

    stars: float
    bound_rad: float
    initial_over_bound: float
    efficient_over_bound: float
    efficient_over_sd: float
    fits: dict[Pair, Fit]


@dataclass(frozen=True)
class Robustness:
    """Errors over the bound by combination and condition, infinite without a result."""

    starts: dict[Pair, list[float]]
    false_matches: dict[Pair, list[float]]


def accuracy_run(scene: Scene, seed: int, pairs: Sequence[Pair]) -> Accuracy:
    """Fit one run's frames by all combinations, from the camera on board."""
    sample = take_sample(scene, seed)
    given = solved_with(sample.given, sample.initial)
    found = {pair: _fitted(scene, given, sample.initial, pair) for pair in pairs}
    return Accuracy(
        stars=float(given.matches_per_exposure.mean()),
        bound_rad=sample.bound_rad,
        initial_over_bound=sample.over_bound(sample.initial.parameters),
        efficient_over_bound=sample.over_bound(sample.efficient),
        efficient_over_sd=_over_sd(
            sample, sample.efficient, sample.scale * np.sqrt(np.diag(sample.bound))
        ),
        fits={
            pair: _figures(sample, fitted) for pair, fitted in found.items() if fitted is not None
        },
    )


def _fitted(scene: Scene, given: MatchedFrames, start: Camera, pair: Pair) -> Fitted | None:
    residual, estimator = pair
    return fit_given(given, start, scene.matcher, RESIDUALS[residual], estimator)


def _figures(sample: Sample, fitted: Fitted) -> Fit:
    return Fit(
        over_bound=sample.over_bound(fitted.parameters),
        error_over_sd=_over_sd(sample, fitted.parameters, fitted.sd),
        us_per_frame=_US * fitted.seconds / sample.given.frames.n_frames,
        kept_bytes=fitted.kept_bytes,
    )


def _over_sd(sample: Sample, parameters: Floats, sd: Floats) -> float:
    error = (parameters - sample.true.parameters) / sd
    return float(np.sqrt(np.mean(error**2)))


def robustness_run(scene: Scene, seed: int, pairs: Sequence[Pair]) -> Robustness:
    """Fit one run's frames from bad starts, and with false matches from the camera on board."""
    sample = take_sample(scene, seed)
    rng = np.random.default_rng((seed, 1))
    offset = rng.normal(size=len(sample.scale)) * sample.scale
    starts = [sample.true.with_parameters(sample.true.parameters + k * offset) for k in STARTS]
    bad = [(solved_with(sample.given, start), start) for start in starts]
    wrong = [with_false_matches(sample.given, share, rng) for share in FALSE_SHARES]
    false = [(solved_with(sample.given, sample.initial, s_i), sample.initial) for s_i in wrong]
    return Robustness(
        starts={pair: [_end(scene, sample, *case, pair) for case in bad] for pair in pairs},
        false_matches={
            pair: [_end(scene, sample, *case, pair) for case in false] for pair in pairs
        },
    )


def _end(scene: Scene, sample: Sample, given: MatchedFrames, start: Camera, pair: Pair) -> float:
    """Return the error over the bound at which a fit ends, infinite without a result."""
    fitted = _fitted(scene, given, start, pair)
    over = np.inf if fitted is None else sample.over_bound(fitted.parameters)
    return float(over) if np.isfinite(over) else float("inf")
