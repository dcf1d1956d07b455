"""One run of a case of the study ``tracking``: its figures, to be pooled with other runs'."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.simulate import Scenario
from stcal.studies.tracking_cases import Case, Followed, follow
from stcal.studies.tracking_measures import (
    Track,
    back_after,
    consistency,
    following,
    foreseen,
    pairs_of_truth,
    squares_by_frame,
    step_frame,
    track,
)
from stcal.studies.tracking_series import block_errors, series, shown_frames

Floats = NDArray[np.float64]

# Frames until the initial offset is forgotten: shares and errors count from there on.
SETTLED_FRAMES = 100
# Frames shown before and after a step.
_AROUND_STEP = (20, 80)


def study_run(case: Case, scenario: Scenario, seed: int, with_series: bool) -> dict[str, Any]:
    """Simulate one case under one seed, run its filters, and return their figures.

    ``with_series`` adds what the report's figures show.
    """
    followed = follow(case, scenario, seed)
    found = {name: result.document["sequential"] for name, result in followed.results.items()}
    run: dict[str, Any] = {"sequential": found}
    return run | _measured(case, followed, with_series) if case.walks else run


def settled_frames(count: int) -> int:
    """Return from which of ``count`` frames on a filter has settled."""
    return min(SETTLED_FRAMES, count // 4)


def _measured(case: Case, followed: Followed, with_series: bool) -> dict[str, Any]:
    """Return how truth and estimates agree, and how well stars fit, in one run."""
    truth = followed.simulation.calibration.truth.parameters
    step = step_frame(truth) if case.steps else None
    tracks = {name: track(r.runs[r.chosen]) for name, r in followed.results.items()}
    errors = _errors_by_frame(followed, truth)
    first = settled_frames(len(truth))
    found: dict[str, Any] = {
        "step_frame": step,
        "squares": {
            name: (squares[first:].sum(), pairs[first:].sum())
            for name, (squares, pairs) in errors.items()
        },
        "variants": {
            name: {"parameters": _consistency(followed, estimate)}
            | _moving(case, followed, estimate, step)
            for name, estimate in tracks.items()
        },
    }
    if with_series:
        frames = followed.simulation.calibration.frames
        found |= {"series": _series(followed, tracks, step), "blocks": block_errors(frames, errors)}
    return found


def _errors_by_frame(
    followed: Followed, truth: Floats
) -> dict[str, tuple[Floats, NDArray[np.int64]]]:
    """Return squares and pairs by frame of each variant's foresight, and of the true camera."""
    arcs = pairs_of_truth(followed)
    cameras = {name: foreseen(r.runs[r.chosen]) for name, r in followed.results.items()}
    return {
        name: squares_by_frame(followed, arcs, parameters)
        for name, parameters in ({"true": truth} | cameras).items()
    }


def _consistency(followed: Followed, estimate: Track) -> dict[str, dict[str, float]]:
    """Return how the errors of each parameter agree with their sd, once settled."""
    truth = followed.simulation.calibration.truth.parameters
    first, error = settled_frames(len(truth)), estimate.value - truth
    return {
        name: consistency(error[first:, k], estimate.sd[first:, k])
        for k, name in enumerate(followed.simulation.initial.camera.parameter_names)
    }


def _moving(
    case: Case, followed: Followed, estimate: Track, step: int | None
) -> dict[str, dict[str, Any]]:
    """Return how the parameters that move are followed, or when they are back after a step."""
    names = followed.simulation.initial.camera.parameter_names
    part = followed.simulation.calibration
    truth, value = part.truth.parameters, estimate.value
    first, places = settled_frames(len(truth)), {p: names.index(p) for p in case.moving}
    if step is None:
        kept = slice(first, None)
        times = part.frames.t_tai_ns[kept]
        return {
            "following": {p: following(value[kept, k], truth[kept, k], times)
                          for p, k in places.items()}
        }  # fmt: skip
    error = value - truth
    return {
        "back_after": {p: back_after(error[:, k], estimate.sd[:, k], step)
                       for p, k in places.items()}
    }  # fmt: skip


def _series(followed: Followed, tracks: dict[str, Track], step: int | None) -> dict[str, Any]:
    """Return truth and estimates for plotting: all frames, thinned, and those around a step."""
    count = followed.simulation.calibration.frames.n_frames
    found = {"all": series(followed, tracks, shown_frames(count))}
    if step is not None:
        before, after = _AROUND_STEP
        around = np.arange(max(step - before, 0), min(step + after, count))
        found["around_step"] = series(followed, tracks, around)
    return found
