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
from stcal.pipeline.estimate import Solution, estimate_of
from stcal.pipeline.evidence import choose_model
from stcal.pipeline.filter_run import FrameHistory, Run, run_filter
from stcal.pipeline.filter_state import FilterState
from stcal.pipeline.filtering import Variant, make_filter
from stcal.pipeline.fit import check_calibration, fitted_calibration
from stcal.pipeline.fitting import Fitting, linearised_at
from stcal.pipeline.gates import sequential_refusals
from stcal.pipeline.identifying import Identify, series_step
from stcal.pipeline.parameters import embedded, parameter_scale
from stcal.pipeline.pieces import Piece, pieces_of
from stcal.pipeline.scratch import MemoryScratch, Scratch
from stcal.pipeline.sums import total

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
    pieces = pieces_of(batches)
    check_calibration(initial, matcher.config, pieces[0].fragment.sensor_id)
    check_variant(variant)
    variant.residual.check()
    task = partial(_baseline, initial=initial, matcher=matcher, variant=variant)
    baseline = list(mapper(task, pieces))
    runs = {}
    for name in ("constant", "thermal") if variant.temperature else ("constant",):
        chosen = make_filter(variant, initial, matcher, thermal=name == "thermal")
        state = (states or {}).get(name, chosen.start)
        runs[name] = run_filter(chosen, baseline, state, (before or {}).get(name), on_fragment)
    choice = choose_model(runs, matcher.config.sequential.temperature_evidence)
    scratch = MemoryScratch()
    solution, fitting = _final_pass(runs[choice], pieces, initial, matcher, scratch, mapper)
    keep = Identify(
        scratch, matcher, initial.camera, initial.c_sd, "baseline", variant.matches, None,
        series_step(pieces),
    ).keep  # fmt: skip
    first = total(keep(piece, matched) for piece, matched in zip(pieces, baseline, strict=True))
    estimate = estimate_of(solution, fitting, pieces, initial, ("baseline", first), matcher, mapper)
    refusals = sequential_refusals(estimate, runs[choice], initial, matcher.config)
    document = describe_sequential.sequential_document(
        estimate, runs, choice, pieces, initial, matcher, refusals, provenance, variant
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
    piece: Piece, initial: Calibration, matcher: Matcher, variant: Variant
) -> MatchedFrames:
    """Return what the calibration on board identifies in the frames."""
    camera, frames = initial.camera, piece.read()
    if variant.matches == "telemetry":
        known = telemetered_matches(frames, camera, matcher)
        return rematch_given(frames, camera, matcher.catalogue, known)
    return match(frames, camera, initial.c_sd, matcher, variant.matches)


def _final_pass(
    run: Run,
    pieces: Sequence[Piece],
    initial: Calibration,
    matcher: Matcher,
    scratch: Scratch,
    mapper: OrderedMap,
) -> tuple[Solution, Fitting]:
    """Rematch all frames with the final camera and linearise there, as a batch fit's last cycle."""
    camera, config = initial.camera.with_parameters(run.camera_parameters), matcher.config
    identify = Identify(
        scratch, matcher, camera, initial.c_sd, "final", "lost-in-space", None,
        series_step(pieces),
    )  # fmt: skip
    identified = total(mapper(identify, pieces))
    free = run.filter.model.target[run.filter.constants]
    fitting = Fitting(scratch, "final", config, run.filter.residual, free)
    kept, information = linearised_at(fitting, pieces, camera, identified.departures, mapper)
    scale = parameter_scale(config, camera.parameter_names)[free]
    solution = Solution(
        identified=identified,
        kept=kept,
        camera=camera,
        free=free,
        information=scaled(information, scale),
        residual=run.filter.residual,
        covariance=embedded(_covariance(run, scale), free, len(camera.parameters)),
        noise_scale=float(run.history.noise_scale[-1]),
    )
    return solution, fitting


def _covariance(run: Run, scale: Floats) -> Floats:
    """Return the filter's covariance of the estimated parameters in their own units."""
    where = run.filter.constants
    found = run.filter.covariance(run.state)[np.ix_(where, where)]
    return np.asarray(found * np.outer(scale, scale))
