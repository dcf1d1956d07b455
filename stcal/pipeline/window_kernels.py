"""The window of latest frames, which are linearised anew when the state has moved far (numba).

A filter that linearises each frame once learns from its first, poor linearisations what isn't true
along the weak directions, and never forgets it.
"""

from __future__ import annotations

import math

import numpy as np

from stcal.cameras.noise_kernels import slope_table
from stcal.jit import kernel
from stcal.pipeline.layout_kernels import ROOM
from stcal.pipeline.measurement_kernels import camera_of, update_by_frame
from stcal.pipeline.watch_kernels import noise_scale

# A state that moved further than this (in units of its scale) since the window was linearised is
# linearised anew.
_RELINEARISE = 0.1
_ITERATIONS = 20
# The point of linearisation moves by no more than this at a time (in units of the state's scale).
_LONGEST = 2.0
# A variance under which no star is screened out.
_UNSURE = 1e4


@kernel
def keep(f, telemetry, star, s_i, c_di, kept):
    """Put the matched stars of frame ``f`` in the window and return its slot."""
    slot = (kept.place[0] + kept.place[1]) % kept.facts.shape[0]
    kept.place[1] += 1
    first = telemetry.offsets[2 * f]
    count = 0
    for e in range(2):
        before = count
        for k in range(telemetry.offsets[2 * f + e], telemetry.offsets[2 * f + e + 1]):
            if star[k - first] >= 0:
                kept.star[slot, count, 0] = telemetry.row_px[k]
                kept.star[slot, count, 1] = telemetry.col_px[k]
                kept.star[slot, count, 2:5] = s_i[k - first]
                kept.star[slot, count, 5] = telemetry.sd_px[k]
                count += 1
        kept.facts[slot, e] = count - before
        # An exposure without matches has no attitude.
        if count > before:
            kept.c_di[slot, e] = c_di[e]
        else:
            kept.c_di[slot, e] = 0.0
    kept.star[slot, count:] = 0.0
    kept.facts[slot, 2], kept.facts[slot, 3] = telemetry.warmth[f], telemetry.gap[f]
    return slot


@kernel
def note(kept, slot, x, root):
    """Note the state after a kept frame."""
    kept.after[slot, 0], kept.after[slot, 1:] = x, root


@kernel
def _advance(functions, model, rules, kept, slot, at, own, x, root, covariance, scale):
    """Bring a state from before a kept frame to after it, linearised at ``at``; returns its NIS.

    The frame's stars are judged by ``at`` and ``covariance``, or by the frame's ``own`` state.
    """
    predict, covariance_of = functions[4], functions[5]
    if kept.facts[slot, 3] > 0.0:
        predict(root, model.noise_sd * (kept.facts[slot, 3] / scale))
    innovation, score = np.empty(ROOM * kept.star.shape[1]), np.zeros(2)
    judge = at
    if own:
        judge, covariance = x.copy(), np.empty(root.shape)
        covariance_of(root, covariance)
    update_by_frame(
        functions, model, rules, kept, slot, at, judge, True, x, root, covariance, scale,
        innovation, score,
    )  # fmt: skip
    note(kept, slot, x, root)
    return score[0]


@kernel
def drop_oldest(state, kept):
    """Take the oldest frame out of the window, into the state before it."""
    oldest = kept.place[0]
    state.base_x[:], state.base_root[:, :] = kept.after[oldest, 0], kept.after[oldest, 1:]
    kept.place[0] = (oldest + 1) % kept.facts.shape[0]
    kept.place[1] -= 1


@kernel
def _by_own_state(model, state):
    """Whether kept frames are judged by their own state rather than by the latest.

    While parameters drift the latest state is another camera than an older frame's: its gate would
    cut the noise of far stars on one side.  Parameters that stay are known best by the latest
    state, and before the window has left the start a frame's own state is next to the prior.
    """
    return (model.noise_sd > 0.0).any() and not (state.base_x == state.start_x).all()


@kernel
def find_slopes(camera, model, x):
    """Fill the model's table of the noise's slopes at a state."""
    values = np.empty(model.reference.shape[0])
    camera_of(model, x, 0.0, values)
    slope_table(camera, values, model.pixel_size_m, model.rows, model.cols, model.slope_table)


@kernel
def linearise_window(functions, model, rules, state, kept, covariance):
    """Filter the window again, linearised at the current state, until the state stays.

    While it holds all frames since the start, it is also linearised from the start a few times: the
    first frames alone may lead to another minimum (a principal point on the other side with the
    opposite distortion), which later ones show to be worse.  Returns the number of times.
    """
    times = _settle(functions, model, rules, state, kept, covariance)
    if _is_due(state, kept):
        times += _settle_from_start(functions, model, rules, state, kept, covariance)
    return times


@kernel
def _settle(functions, model, rules, state, kept, covariance):
    """Linearise the window at the current state until that stays; returns the number of times."""
    for iteration in range(_ITERATIONS):
        moved = np.abs(state.x - state.linearised_at).max()
        if not moved > _RELINEARISE:
            return iteration
        _step(state, moved, iteration)
        _filter_window(functions, model, rules, state, kept, covariance)
    return _ITERATIONS


@kernel
def _step(state, moved, iteration):
    """Move the point of linearisation towards the state, along the valley rather than across."""
    # After a while with half steps: along weak directions full ones may swing.
    weight = 1.0 if iteration < _ITERATIONS // 2 else 0.5
    state.linearised_at[:] += min(weight, _LONGEST / moved) * (state.x - state.linearised_at)


@kernel
def _filter_window(functions, model, rules, state, kept, covariance):
    """Filter the kept frames from the state before them; returns their NIS, the window's cost."""
    # Far from the noise, its slopes have a great part in the derivatives.
    if np.abs(state.linearised_at - state.sloped_at).max() > _RELINEARISE:
        state.sloped_at[:] = state.linearised_at
        find_slopes(functions[0], model, state.sloped_at)
    scale, cost, own = noise_scale(state.tally), 0.0, _by_own_state(model, state)
    state.x[:], state.root[:, :] = state.base_x, state.base_root
    for k in range(kept.place[1]):
        slot = (kept.place[0] + k) % kept.facts.shape[0]
        cost += _advance(
            functions, model, rules, kept, slot, state.linearised_at, own, state.x, state.root,
            covariance, scale,
        )  # fmt: skip
    return cost


@kernel
def _is_due(state, kept):
    """Whether the window holds all frames since the start, and is at one of a few lengths."""
    count = kept.place[1]
    if not (state.base_x == state.start_x).all():
        return False
    return count in (2, 3, 5, 8, 12, 18, 27, 40)


@kernel
def _settle_from_start(functions, model, rules, state, kept, covariance):
    """Linearise the window from the start; that result stays when its cost is lower.

    Stars are not screened meanwhile: both costs must be of the same ones, and ``covariance``
    (n, n) belongs to the result so far.
    """
    unsure = _UNSURE * np.eye(state.x.shape[0])
    here, cost = state.linearised_at.copy(), math.inf
    limit = _filter_window(functions, model, rules, state, kept, unsure)
    state.linearised_at[:] = state.start_x
    for iteration in range(_ITERATIONS):
        cost = _filter_window(functions, model, rules, state, kept, unsure)
        moved = np.abs(state.x - state.linearised_at).max()
        if not moved > _RELINEARISE:
            break
        _step(state, moved, iteration)
    if not cost < limit - 1.0:
        state.linearised_at[:] = here
        _filter_window(functions, model, rules, state, kept, covariance)
    return iteration + 3
