"""The sequential pass: one telemetry frame after the other, from centroids to a new state (numba).

For each frame: time update; star vectors with the current camera; identification (or the
baseline's matches); screening of stars; arclength residuals; measurement update; and the watch over
the filter (``watch_kernels``).

The latest frames stay in a window (``window_kernels``): when the state has moved far since they
were linearised, they are filtered again, linearised at the new state.

The camera and the estimator come in as function pointers, so that one compiled pass serves all of
them.
"""

from __future__ import annotations

import math

import numpy as np

from stcal.jit import kernel, pointer
from stcal.matching.kernels import identify
from stcal.pipeline.layout_kernels import PASS_SIGNATURE, ROOM
from stcal.pipeline.measurement_kernels import camera_of, star_vectors, update_by_frame
from stcal.pipeline.watch_kernels import noise_scale, watch
from stcal.pipeline.window_kernels import drop_oldest, find_slopes, keep, linearise_window, note


@kernel
def _identify(f, camera, telemetry, baseline, model, rules, sky, rule, work, x, star, s_i, c_di):
    """Match a frame with the state's camera, or take the baseline's matches; returns if fixed."""
    first, last = telemetry.offsets[2 * f], telemetry.offsets[2 * f + 2]
    if not rules.rematch:
        star[:], s_i[:, :] = baseline.star[first:last], baseline.s_i[first:last]
        c_di[:, :, :] = baseline.c_di[2 * f : 2 * f + 2]
        return baseline.status[2 * f] == 0 or baseline.status[2 * f + 1] == 0
    values = np.empty(model.reference.shape[0])
    camera_of(model, x, telemetry.warmth[f], values)
    s_d, _, _ = star_vectors(
        camera, model, values, telemetry.row_px[first:last], telemetry.col_px[first:last],
        telemetry.sd_px[first:last],
    )  # fmt: skip
    offsets = telemetry.offsets[2 * f : 2 * f + 3] - first
    status, residual = np.empty(2, np.int8), np.empty(last - first)
    identify(
        offsets, s_d, telemetry.intensity[first:last], telemetry.observers[f : f + 1],
        telemetry.hints[2 * f : 2 * f + 2], rules.guided, sky, rule, work,
        star, s_i, residual, c_di, status,
    )  # fmt: skip
    return status[0] == 0 or status[1] == 0


@kernel
def _one_frame(
    f, functions, telemetry, baseline, model, rules, sky, rule, work, state, kept, history,
    covariance, star, s_i,
):  # fmt: skip
    """Identify frame ``f`` and update the state by it."""
    camera = functions[0]
    first, last = telemetry.offsets[2 * f], telemetry.offsets[2 * f + 2]
    c_di, score = np.empty((2, 3, 3)), np.empty(2)
    at = model.linearise_at if rules.fixed else state.x.copy()
    history.fixed[f] = _identify(
        f, camera, telemetry, baseline, model, rules, sky, rule, work, at, star[first:last],
        s_i[first:last], c_di,
    )  # fmt: skip
    history.matched[f] = (star[first:last] >= 0).sum()
    if kept.place[1] == kept.facts.shape[0]:
        drop_oldest(state, kept)
    slot = keep(f, telemetry, star[first:last], s_i[first:last], c_di, kept)
    history.arcs[f], count, history.rejected[f] = update_by_frame(
        functions, model, rules, kept, slot, at, at, False, state.x, state.root, covariance,
        noise_scale(state.tally), history.innovation[ROOM * first : ROOM * last], score,
    )  # fmt: skip
    note(kept, slot, state.x, state.root)
    history.innovations[f], history.iterations[f] = count, 0
    history.nis[f], history.log_determinant[f] = (score[0], score[1]) if count else (
        math.nan, math.nan,
    )  # fmt: skip
    if not rules.fixed and np.isfinite(state.x).all():
        history.iterations[f] = linearise_window(functions, model, rules, state, kept, covariance)


def _run_pass(
    camera, bind, residual, update, predict, covariance_of,
    telemetry, baseline, model, rules, sky, rule, work, state, kept, history, star, s_i,
):  # fmt: skip
    """Filter a stretch of frames; ``state``, ``history`` and the matches are filled in place.

    ``star`` (S,) and ``s_i`` (S, 3) become the matches under the state before each frame.
    """
    n = state.x.shape[0]
    covariance = np.empty((n, n))
    find_slopes(camera, model, state.sloped_at)
    for f in range(telemetry.warmth.shape[0]):
        if telemetry.gap[f] > 0.0:
            predict(state.root, model.noise_sd * (telemetry.gap[f] / noise_scale(state.tally)))
        covariance_of(state.root, covariance)
        _one_frame(
            f, (camera, bind, residual, update, predict, covariance_of), telemetry, baseline,
            model, rules, sky, rule, work, state, kept, history, covariance, star, s_i,
        )  # fmt: skip
        covariance_of(state.root, covariance)
        watch(f, baseline, state, kept, rules, history, telemetry, covariance)
        covariance_of(state.root, covariance)
        scale = noise_scale(state.tally)
        history.x[f], history.noise_scale[f] = state.x, scale
        for k in range(n):
            history.sd[f, k] = math.sqrt(covariance[k, k]) * scale


run_pass = pointer(PASS_SIGNATURE)(_run_pass)
