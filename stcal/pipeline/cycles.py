"""Cycles of rematching and refitting, Enright 2018 section II-C."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from stcal.calibration import Calibration
from stcal.cameras import Camera
from stcal.config import SensorConfig
from stcal.estimators.batch import BatchSolution, levenberg_marquardt
from stcal.estimators.information import SquareRootInformation, merge
from stcal.execution import OrderedMap
from stcal.frames import FrameBatch, MatchedFrames
from stcal.matching import Matcher, match
from stcal.matching.identify import rematch_given, telemetered_matches
from stcal.pipeline.parameters import parameter_scale
from stcal.residuals import BoundArclength, BoundResidual, Residual, bind_arclength
from stcal.residuals.selection import (
    StarSelection,
    reject_outliers,
    robust_scale,
    select_stars,
    star_departures,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Outliers are judged anew after each fit; it settles in two or three rounds.
_REJECTION_ROUNDS = 5
# Matches that may still flicker at the tolerance's edge when the set counts as settled.
_SETTLED_SHARE = 1e-3


@dataclass(frozen=True)
class Cycle:
    """What one cycle of matching and fitting did."""

    matching: str
    matched: list[MatchedFrames]
    bound: list[BoundResidual]
    solution: BatchSolution
    camera: Camera
    noise_scale: float
    rejected: int
    changed: int

    @cached_property
    def arcs(self) -> list[BoundArclength]:
        """The arclengths of the stars used, whatever they were fitted by: for figures."""
        return [arcs_of(b, self.camera) for b in self.bound]

    @property
    def matched_stars(self) -> int:
        """Number of matched stars."""
        return sum(int(m.is_matched.sum()) for m in self.matched)


def run_cycles(
    batches: Sequence[FrameBatch],
    initial: Calibration,
    matcher: Matcher,
    matches: str,
    residual: Residual,
    free: Ints,
    mapper: OrderedMap,
    on_cycle: Callable[[Cycle], None],
) -> tuple[list[Cycle], bool]:
    """Match and fit until the matched set settles; return the cycles and whether it did.

    ``matches`` says where the first cycle's matches come from: ``telemetry`` or a matching method.
    ``free`` are the places of the parameters to estimate; the others keep their initial values.
    Later cycles rematch with the latest camera: lost in space if the first was, else guided by the
    previous matches.
    """
    config, camera = matcher.config, initial.camera
    cycles: list[Cycle] = []
    previous: list[MatchedFrames] | None = None
    for _ in range(config.fit.maximum_cycles):
        method = matches if previous is None else _later(matches)
        items = [
            (batch, None if previous is None else previous[k]) for k, batch in enumerate(batches)
        ]
        task = partial(_match_one, camera=camera, c_sd=initial.c_sd, matcher=matcher, method=method)
        matched = list(mapper(task, items))
        changed = _changes(previous, matched)
        cycle = _fit_matched(matched, camera, config, residual, free, mapper, method, changed)
        cycles.append(cycle)
        on_cycle(cycle)
        if not np.isfinite(cycle.camera.parameters).all() or not cycle.bound:
            return cycles, False
        settled = changed <= _SETTLED_SHARE * max(cycle.matched_stars, 1)
        if previous is not None and settled:
            return cycles, True
        camera, previous = cycle.camera, matched
    return cycles, False


def _later(matches: str) -> str:
    return "lost-in-space" if matches == "lost-in-space" else "guided"


def _match_one(
    item: tuple[FrameBatch, MatchedFrames | None],
    camera: Camera,
    c_sd: Floats,
    matcher: Matcher,
    method: str,
) -> MatchedFrames:
    frames, previous = item
    if method == "telemetry":
        known = telemetered_matches(frames, camera, matcher)
        return rematch_given(frames, camera, matcher.catalogue, known)
    hints = None
    if method == "guided" and previous is not None:
        # The new camera's D frame may be turned against the old: solve the old matches in it.
        hints = rematch_given(frames, camera, matcher.catalogue, previous.star).c_di
    return match(frames, camera, c_sd, matcher, method, hints)


def _changes(previous: list[MatchedFrames] | None, now: list[MatchedFrames]) -> int:
    if previous is None:
        return sum(int(m.is_matched.sum()) for m in now)
    return sum(int((a.star != b.star).sum()) for a, b in zip(previous, now, strict=True))


def _fit_matched(
    matched: list[MatchedFrames],
    camera: Camera,
    config: SensorConfig,
    residual: Residual,
    free: Ints,
    mapper: OrderedMap,
    matching: str,
    changed: int,
) -> Cycle:
    """Fit the camera to one set of matches, leaving out outliers until they settle."""
    minimum = config.fit.minimum_stars_per_exposure
    everything = [select_stars(m, config.noise, minimum) for m in matched]
    total = sum(len(s.star) for s in everything)
    scale = parameter_scale(config, camera.parameter_names)
    kept_before: list[StarSelection] | None = None
    for _ in range(_REJECTION_ROUNDS):
        kept = without_outliers(everything, camera, config, mapper)
        if kept_before is not None and _same(kept_before, kept):
            break
        bound = list(mapper(partial(residual.bind, camera=camera), kept))
        solution = solve(bound, camera, scale, free, mapper)
        camera, kept_before = with_estimated(camera, free, solution.parameters), kept
    kept_before = kept_before or []
    used = sum(len(s.star) for s in kept_before)
    dof = solution.information.rows - len(free)
    return Cycle(
        matching=matching,
        matched=matched,
        bound=bound,
        solution=solution,
        camera=camera,
        noise_scale=float(np.sqrt(solution.chi2 / dof)) if dof > 0 else float("nan"),
        rejected=total - used,
        changed=changed,
    )


def arcs_of(bound: BoundResidual, camera: Camera) -> BoundArclength:
    """Return the arclengths of a residual's stars."""
    return bound if isinstance(bound, BoundArclength) else bind_arclength(bound.selection, camera)


def without_outliers(
    everything: Sequence[StarSelection], camera: Camera, config: SensorConfig, mapper: OrderedMap
) -> list[StarSelection]:
    """Leave out stars beyond ``rejection_sigma`` robust sd, at a scale common to all fragments."""
    departures = list(mapper(partial(star_departures, camera=camera), everything))
    reject = partial(
        reject_outliers,
        camera=camera,
        sigma=config.fit.rejection_sigma,
        scale=robust_scale(np.concatenate(departures)),
        minimum=config.fit.minimum_stars_per_exposure,
    )
    return list(mapper(reject, everything))


def _same(a: Sequence[StarSelection], b: Sequence[StarSelection]) -> bool:
    return all(np.array_equal(x.star, y.star) for x, y in zip(a, b, strict=True))


def with_estimated(camera: Camera, free: Ints, values: Floats) -> Camera:
    """Return the camera with new values of the estimated parameters."""
    parameters = camera.parameters.copy()
    parameters[free] = values
    return camera.with_parameters(parameters)


def solve(
    bound: Sequence[BoundResidual], camera: Camera, scale: Floats, free: Ints, mapper: OrderedMap
) -> BatchSolution:
    """Run the batch estimator over fragments of whitened residuals, for parameters ``free``."""

    def linearise(values: Floats) -> SquareRootInformation:
        return information_at(bound, with_estimated(camera, free, values), free, mapper)

    return levenberg_marquardt(linearise, camera.parameters[free], scale[free])


def information_at(
    bound: Sequence[BoundResidual], camera: Camera, free: Ints, mapper: OrderedMap
) -> SquareRootInformation:
    """Return the merged factor of [H | r] at a camera, for parameters ``free``."""
    return merge(mapper(partial(_reduce, camera=camera, free=free), bound))


def _reduce(bound: BoundResidual, camera: Camera, free: Ints) -> SquareRootInformation:
    return SquareRootInformation(bound.reduce(camera, free), bound.rows)
