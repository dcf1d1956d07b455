"""Stage ``fit --sequential``: refit the camera one telemetry frame at a time, Enright 2018 II-D.

The baseline identifies all frames first (for the watch, and for C_SD); then the filter takes frame
after frame; a final pass rematches everything with the final camera, as after a batch fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.calibration import Calibration
from stcal.errors import UsageError
from stcal.estimators.information import scaled
from stcal.estimators.sequential import SEQUENTIAL
from stcal.execution import OrderedMap, serial
from stcal.frames import FrameBatch, MatchedFrames
from stcal.matching import Matcher, match
from stcal.matching.identify import rematch_given, telemetered_matches
from stcal.pipeline import describe_sequential
from stcal.pipeline.cycles import arcs_of, information_at, without_outliers
from stcal.pipeline.estimate import Solution, estimate_of
from stcal.pipeline.evidence import choose_model
from stcal.pipeline.filter_run import FrameHistory, Run, run_filter
from stcal.pipeline.filter_state import FilterState
from stcal.pipeline.filtering import Variant, make_filter
from stcal.pipeline.fit import check_calibration, fitted_calibration
from stcal.pipeline.gates import sequential_refusals
from stcal.pipeline.parameters import embedded, parameter_scale
from stcal.residuals import select_stars

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class SequentialResult:
    """A finished sequential fit.

    ``calibration`` is None when a gate refused; ``runs`` are the filters by name (``constant``, and
    ``thermal`` where parameters may depend on the temperature), ``chosen`` the one that counts.
    """

    calibration: Calibration | None
    document: dict[str, Any]
    runs: dict[str, Run]
    chosen: str

    @property
    def history(self) -> FrameHistory:
        """The chosen filter's history."""
        return self.runs[self.chosen].history

    @property
    def states(self) -> dict[str, FilterState]:
        """The filters' states, to go on from."""
        return {name: run.state for name, run in self.runs.items()}


def fit_sequential(
    batches: Sequence[FrameBatch],
    initial: Calibration,
    matcher: Matcher,
    provenance: dict[str, Any],
    variant: Variant,
    states: dict[str, FilterState] | None = None,
    before: dict[str, FrameHistory] | None = None,
    mapper: OrderedMap = serial,
    on_fragment: Callable[[], None] = lambda: None,
) -> SequentialResult:
    """Refit the camera of ``initial`` frame by frame.

    Parameters
    ----------
    batches : the sensor's frames, fragment by fragment in time order
    initial : the calibration to start from, and to fall back to
    matcher : catalogue and sensor configuration
    provenance : hashes and time span, stored in the calibration and the document
    variant : which filter, and how
    states, before : states and histories of an earlier run to go on from; the frames that it has
        seen are not filtered again, but count for C_SD and the final figures
    mapper : ordered map over the fragments, for what needs no order
    on_fragment : told about each filtered fragment
    """
    batches = [batch for batch in batches if batch.n_frames]
    check_calibration(initial, matcher.config, batches[0].sensor_id)
    check_variant(variant)
    variant.residual.check()
    baseline = list(mapper(partial(_baseline, initial=initial, matcher=matcher, variant=variant),
                           batches))  # fmt: skip
    runs = {}
    for name in ("constant", "thermal") if variant.temperature else ("constant",):
        chosen = make_filter(variant, initial, matcher, thermal=name == "thermal")
        state = (states or {}).get(name, chosen.start)
        runs[name] = run_filter(chosen, baseline, state, (before or {}).get(name), on_fragment)
    choice = choose_model(runs, matcher.config.sequential.temperature_evidence)
    solution = _final_pass(runs[choice], batches, initial, matcher, mapper)
    estimate = estimate_of(solution, initial, baseline, matcher, mapper)
    refusals = sequential_refusals(estimate, runs[choice], initial, matcher.config)
    document = describe_sequential.sequential_document(
        estimate, runs, choice, batches, initial, matcher, refusals, provenance, variant
    )
    return SequentialResult(fitted_calibration(estimate, initial, document), document, runs, choice)


def check_variant(variant: Variant) -> None:
    """Refuse combinations that make no sense.

    Raises
    ------
    UsageError
    """
    estimator = SEQUENTIAL[variant.method]
    if variant.matches == "telemetry" and variant.rematch:
        raise UsageError("telemetered matches are fixed: give --no-rematch with them")
    if variant.precision not in estimator.steps:
        raise UsageError(f"{variant.method} has no {variant.precision} precision")
    held = (
        []
        if variant.parameters is None
        else [name for name in variant.temperature if name not in variant.parameters]
    )
    if held:
        raise UsageError(f"held fixed, so not to depend on temperature: {', '.join(held)}")
    if estimator.constant and any((variant.process_noise or {}).values()):
        raise UsageError(f"{variant.method} takes parameters as constants: no process noise")


def _baseline(
    frames: FrameBatch, initial: Calibration, matcher: Matcher, variant: Variant
) -> MatchedFrames:
    """Return what the calibration on board identifies in the frames."""
    camera = initial.camera
    if variant.matches == "telemetry":
        known = telemetered_matches(frames, camera, matcher)
        return rematch_given(frames, camera, matcher.catalogue, known)
    return match(frames, camera, initial.c_sd, matcher, variant.matches)


def _final_pass(
    run: Run,
    batches: Sequence[FrameBatch],
    initial: Calibration,
    matcher: Matcher,
    mapper: OrderedMap,
) -> Solution:
    """Rematch all frames with the final camera and bind its arcs, as a batch fit's last cycle."""
    camera, config = initial.camera.with_parameters(run.camera_parameters), matcher.config
    rematch = partial(match, camera=camera, c_sd=initial.c_sd, matcher=matcher)
    matched = list(mapper(rematch, batches))
    minimum = config.fit.minimum_stars_per_exposure
    stars = [select_stars(m, config.noise, minimum) for m in matched]
    kept = without_outliers(stars, camera, config, mapper)
    residual = run.filter.residual
    bound = list(mapper(partial(residual.bind, camera=camera), kept))
    free = run.filter.model.target[run.filter.constants]
    scale = parameter_scale(config, camera.parameter_names)[free]
    information = scaled(information_at(bound, camera, free, mapper), scale)
    return Solution(
        matched=matched,
        bound=[arcs_of(b, camera) for b in bound],
        camera=camera,
        free=free,
        information=information,
        residual=residual,
        dependent=sum(b.dependent for b in bound),
        covariance=embedded(_covariance(run, scale), free, len(camera.parameters)),
        noise_scale=float(run.history.noise_scale[-1]),
        rejected=sum(len(s.star) for s in stars) - sum(len(s.star) for s in kept),
    )


def _covariance(run: Run, scale: Floats) -> Floats:
    """Return the filter's covariance of the estimated parameters in their own units."""
    where = run.filter.constants
    found = run.filter.covariance(run.state)[np.ix_(where, where)]
    return np.asarray(found * np.outer(scale, scale))
