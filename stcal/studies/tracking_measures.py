"""How well a filter follows a camera that changes: truth against estimate, frame by frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.constants import EXPOSURES_PER_FRAME
from stcal.errors import UsageError
from stcal.matching import match
from stcal.metrics import pair_sums
from stcal.pipeline.filter_run import Run
from stcal.residuals.arclength import Arcs
from stcal.studies.evaluation import pairs_of
from stcal.studies.tracking_cases import Followed

Floats = NDArray[np.float64]

_NS_PER_S = 1e9
# Neighbouring frames farther apart than this belong to different stretches of the sky.
_GAP_S = 120.0
# The estimate is back when it stays within 3 sd for so many frames.
_BACK_FRAMES = 25
WITHIN_SD = 3.0


@dataclass(frozen=True)
class Track:
    """Estimates of the camera's parameters and their sd, (F, P), at each frame's temperature."""

    value: Floats
    sd: Floats


def track(run: Run) -> Track:
    """Return the estimates after each frame."""
    return Track(_at_temperature(run, run.history.x), _sd_at_temperature(run))


def foreseen(run: Run) -> Floats:
    """Return the parameters (F, P) that the estimate before a frame foresees for it."""
    before = np.vstack([run.filter.start.x, run.history.x[:-1]])
    return _at_temperature(run, before)


def _at_temperature(run: Run, x: Floats) -> Floats:
    chosen, values = run.filter, run.filter.parameters(x)
    for k in np.flatnonzero(chosen.model.thermal):
        values[:, chosen.model.target[k]] += _warmth(run) * x[:, k] * chosen.model.scale[k]
    return values


def _sd_at_temperature(run: Run) -> Floats:
    """Return the sd (F, P); value and slope are taken as correlated as they are at the end."""
    chosen, model = run.filter, run.filter.model
    sd = run.history.sd * model.scale
    found = np.zeros((len(sd), len(model.reference)))
    found[:, model.target[chosen.constants]] = sd[:, chosen.constants]
    covariance = chosen.covariance(run.state)
    for k in np.flatnonzero(model.thermal):
        value = next(v for v in chosen.constants if model.target[v] == model.target[k])
        correlation = covariance[k, value] / np.sqrt(covariance[k, k] * covariance[value, value])
        by_slope = _warmth(run) * sd[:, k]
        square = sd[:, value] ** 2 + by_slope**2 + 2.0 * correlation * sd[:, value] * by_slope
        found[:, model.target[k]] = np.sqrt(square)
    return found


def _warmth(run: Run) -> Floats:
    """Return (F,) K above the reference temperature, zero where unknown, as the filter takes it."""
    warmth = run.history.temperature_c - run.filter.reference_temperature_c
    return np.nan_to_num(warmth, nan=0.0)


def consistency(error: Floats, sd: Floats) -> dict[str, float]:
    """Return how the errors (F,) of one parameter agree with their sd (F,)."""
    z = np.abs(error) / sd
    return {
        "within_3sd": float((z < WITHIN_SD).mean()),
        "within_1sd": float((z < 1.0).mean()),
        "rms": float(np.sqrt(np.mean(error**2))),
        "rms_z": float(np.sqrt(np.mean(z**2))),
    }


def following(value: Floats, truth: Floats, t_tai_ns: NDArray[np.int64]) -> dict[str, float]:
    """Return which part of the truth's variation an estimate follows, and how late [s].

    Least squares of estimate = mean + part * truth - part * lag * rate over the frames (F,).
    """
    t_s = (t_tai_ns - t_tai_ns[0]) / _NS_PER_S
    stretches = np.split(np.arange(len(t_s)), np.flatnonzero(np.diff(t_s) > _GAP_S) + 1)
    stretches = [part for part in stretches if len(part) > 1]
    rate = np.concatenate([np.gradient(truth[part], t_s[part]) for part in stretches])
    kept = np.concatenate(stretches)
    centred = truth[kept] - truth[kept].mean()
    if not centred.any():
        return {"part": float("nan"), "lag_s": float("nan")}
    size, speed = np.abs(centred).max(), np.abs(rate).max()
    columns = np.stack([np.ones(len(kept)), centred / size, rate / speed], axis=1)
    _, part, late = np.linalg.lstsq(columns, value[kept], rcond=None)[0]
    part, late = part / size, late / speed
    return {"part": float(part), "lag_s": float(-late / part)}


def back_after(error: Floats, sd: Floats, step: int) -> int | None:
    """Return the frames after ``step`` until the errors stay within 3 sd; None when they don't."""
    inside = np.abs(error[step:]) < WITHIN_SD * sd[step:]
    beyond = np.concatenate([[0], np.cumsum(~inside)])
    stays = beyond[_BACK_FRAMES:] == beyond[:-_BACK_FRAMES]
    return int(np.argmax(stays)) if stays.any() else None


def step_frame(parameters: Floats) -> int:
    """Return the first frame of which the true parameters (F, P) differ from the frame before.

    Raises
    ------
    UsageError
        When there is none: the run ends before the step or begins after it.
    """
    changes = np.flatnonzero(np.any(np.diff(parameters, axis=0) != 0.0, axis=1))
    if not len(changes):
        raise UsageError("the camera's step lies outside the simulated frames: give it more frames")
    return int(changes[0]) + 1


def pairs_of_truth(followed: Followed) -> Arcs:
    """Return the star pairs that the simulation's own camera identifies: the same for everyone."""
    simulation, matcher = followed.simulation, followed.matcher
    true, frames = simulation.true, simulation.calibration.frames
    return pairs_of(match(frames, true.camera, true.c_sd, matcher), matcher)


def squares_by_frame(
    followed: Followed, arcs: Arcs, parameters: Floats
) -> tuple[Floats, NDArray[np.int64]]:
    """Return sums (F,) of squared arclength errors [rad^2] and numbers of pairs of each frame.

    ``parameters`` (F, P): each centroid is seen by its own frame's camera.
    """
    frames = followed.simulation.calibration.frames
    frame = frames.exposure_of_star // EXPOSURES_PER_FRAME
    camera = followed.simulation.true.camera
    drifting = camera.with_parameters(parameters[frame[arcs.selection.star]].T)
    sums = pair_sums(arcs, frame, frames.n_frames, drifting)
    return sums.squares, sums.pairs
