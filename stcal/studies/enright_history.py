"""How the filters converge: Figures 3, 4 and 5 of Enright 2018, and what frame after frame brings.

Frames are counted from one: the value at frame k is that after k processed frames.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.constants import EXPOSURES_PER_FRAME
from stcal.frames import FrameBatch
from stcal.matching import Matcher, match
from stcal.pipeline.filter_run import Run
from stcal.pipeline.numbers import number, numbers
from stcal.residuals.arclength import Arcs
from stcal.studies.enright_runs import Fits
from stcal.studies.evaluation import evaluate, pairs_of, rms_urad

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_SHOWN_FRAMES = 100
# The first frames change the most.
_FIRST_FRAMES = 20
_SETTLING_FRAMES = (1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 30, 50, 80, 120, 200, 300)
_FARTHEST_PX, _RADIAL_STEP_PX = 1600.0, 50.0
# What the curve of Figure 5 combines; the rest of a camera isn't radial.
_RADIAL = ("f_m", "b4_per_m4", "b2_per_m2")


def shown_frames(count: int) -> Ints:
    """Return frame numbers, from 1 to ``count``, thinned for plotting."""
    even = np.round(np.linspace(1, count, min(count, _SHOWN_FRAMES))).astype(np.int64)
    return np.unique(np.concatenate([np.arange(1, min(count, _FIRST_FRAMES) + 1), even]))


def convergence(starts: Mapping[str, Fits], batch: Camera) -> dict[str, Any]:
    """Return Figure 3: the focal length minus the batch value (eq 31) over the frames, in m.

    ``starts`` are the fits by where they start.
    """
    run = next(iter(next(iter(starts.values())).runs.values()))
    frames = shown_frames(len(run.history.x))
    series: dict[str, Any] = {"frame": frames.tolist()}
    for start, fits in starts.items():
        series[start] = {
            name: _departure(run, frames - 1, "f_m", batch) for name, run in fits.runs.items()
        }
    return series


def _departure(run: Run, frames: Ints, name: str, batch: Camera) -> dict[str, Any]:
    state = run.filter.names.index(name)
    place = run.filter.model.target[state]
    values = run.filter.parameters(run.history.x[frames])[:, place]
    return {
        "departure": numbers(values - batch.parameters[place]),
        "sd": numbers(run.history.sd[frames, state] * run.filter.model.scale[state]),
    }


def ends(lab: Fits, again: Fits) -> dict[str, Any]:
    """Return where the filters end when started from either calibration, by parameter.

    ``lab`` and ``batch`` are the final values from either start, ``sd`` the filter's own, and
    ``wander`` the sd of the estimates over the second half of the frames, from ``lab``.
    """
    found = {}
    for name, run in lab.runs.items():
        history = run.filter.parameters(run.history.x)
        found[name] = {
            "lab": numbers(run.camera_parameters),
            "batch": numbers(again.runs[name].camera_parameters),
            "sd": numbers(run.history.sd[-1] * run.filter.model.scale),
            "wander": numbers(history[len(history) // 2 :].std(axis=0)),
        }
    return found


def tail_and_aggregate(
    frames: FrameBatch, again: Fits, start: Camera, matcher: Matcher
) -> dict[str, Any]:
    """Return Figure 4: RMS arclength errors of the Q and No-Q filters over the calibration set.

    ``tail_urad`` takes all frames with the estimate after frame k, eq (32); ``aggregate_urad``
    each frame with its own estimate, eq (33).  Both are over the pairs that the camera which the
    filters start from identifies.
    """
    arcs = pairs_of(match(frames, start, again.initial.c_sd, matcher), matcher)
    shown = shown_frames(frames.n_frames)
    series: dict[str, Any] = {"frame": shown.tolist(), "pairs": len(arcs)}
    for name in ("q", "no_q"):
        run = again.runs[name]
        history = run.filter.parameters(run.history.x)
        series[name] = {
            "tail_urad": [
                number(rms_urad(arcs.departures(start.with_parameters(history[k - 1]))))
                for k in shown
            ],
            "aggregate_urad": number(_aggregate(frames, arcs, start, history)),
        }
    return series


def _aggregate(frames: FrameBatch, arcs: Arcs, camera: Camera, history: Floats) -> float:
    """RMS with the estimates (F, P) after each frame: each centroid has its frame's camera."""
    frame = frames.exposure_of_star[arcs.selection.star] // EXPOSURES_PER_FRAME
    return rms_urad(arcs.departures(camera.with_parameters(history[frame].T)))


def radial_difference(cameras: Mapping[str, Camera]) -> dict[str, Any]:
    """Return Figure 5: by how much cameras see a star farther out than the batch camera, in px.

    The combined effect of f, b4 and b2, without principal point, tilt and aspect: the distance of
    the undistorted image, in pixels of the batch camera, over the distance of the centroid.
    """
    batch = cameras["batch"]
    radius = np.arange(0.0, _FARTHEST_PX + 1.0, _RADIAL_STEP_PX)
    scale = batch.value("f_m") / batch.pixel_size_m
    slope = {name: _off_axis_slope(camera, radius) for name, camera in cameras.items()}
    curves = {
        name: numbers(scale * (slope[name] - slope["batch"])) for name in cameras if name != "batch"
    }
    return {"radius_px": numbers(radius), **curves}


def _off_axis_slope(camera: Camera, radius_px: Floats) -> Floats:
    """Tangent of the off-axis angle (N,) of centroids at a distance from the principal point."""
    kept = {name: camera.value(name) for name in _RADIAL}
    centred = {"g_y": 1.0, **kept}
    radial = camera.with_parameters(
        np.array([centred.get(name, 0.0) for name in camera.parameter_names])
    )
    s_d = radial.directions(radius_px, np.zeros(len(radius_px)))
    return np.asarray(s_d[:, 0] / s_d[:, 2])


def settling(frames: FrameBatch, lab: Fits, matcher: Matcher) -> dict[str, Any]:
    """Return availability and common-pair RMS on a telemetry set after k frames, No-Q filter."""
    run = lab.runs["no_q"]
    count = len(run.history.x)
    shown = [k for k in _SETTLING_FRAMES if k < count] + [count]
    history = run.filter.parameters(run.history.x)
    start = lab.initial.camera
    cameras = {"0": start} | {str(k): start.with_parameters(history[k - 1]) for k in shown}
    found = evaluate(frames, cameras, lab.initial.c_sd, matcher)["cameras"]
    return {
        "frame": [0, *shown],
        "availability": [item["availability"] for item in found.values()],
        "rms_urad": [item["rms_urad"] for item in found.values()],
    }
