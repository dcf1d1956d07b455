"""The watch over a sequential filter: noise, divergence, and the fallback to the baseline (numba).

Enright 2018 names the risk that a diverging estimate takes the sensor's matches away.  So every
frame is solved with the baseline too, and the filter starts anew from the baseline when, over the
frames of a window, it fixes fewer frames, matches clearly fewer stars, or its innovations no longer
agree with their covariance.
"""

from __future__ import annotations

import math

import numpy as np

from stcal.jit import kernel

# Events of a frame.
NOTHING, LOST_FRAMES, LOST_STARS, INNOVATIONS, NUMERICAL = range(5)
# Places in the tally.
NIS, DOF, FRAMES, PROBATION = range(4)
TALLY = 4
# Columns of the window: fixed and matched by the estimate and the baseline, NIS, arcs.
WINDOW = 6
# The configured noise counts as this many arcs when the noise scale is estimated.
_PRIOR_ARCS = 100.0
# So many frames with innovations must be in the window before their NIS is judged: single ones
# reach six times the configured noise while the camera is uncertain.
_JUDGED_FRAMES = 5
# One frame raises the noise scale by no more than this (a false match would ruin it).
_LARGEST_SHARE = 9.0


@kernel
def clear_tally(tally):
    """Start the tally: the configured noise is right as far as is known."""
    tally[:] = 0.0
    tally[NIS] = tally[DOF] = _PRIOR_ARCS


@kernel
def noise_scale(tally):
    """Sd of the innovations over the configured noise, by all frames so far.

    The filter computes in units of the configured noise; with process noise alone in other units,
    a common factor of all covariances is estimated beside the state (the conjugate update of an
    unknown variance; Gelman et al. 2013, section 3.3).
    """
    return math.sqrt(tally[NIS] / tally[DOF])


@kernel
def watch(f, baseline, state, kept, rules, history, telemetry, covariance):
    """Count frame ``f`` and start the filter anew when it is not to be trusted.

    ``covariance`` (n, n) is that of the state after the frame.
    """
    tally, window = state.tally, state.window
    first, last = telemetry.offsets[2 * f], telemetry.offsets[2 * f + 2]
    row = window[int(tally[FRAMES]) % window.shape[0]]
    row[0], row[2] = history.fixed[f], history.matched[f]
    row[1] = baseline.status[2 * f] == 0 or baseline.status[2 * f + 1] == 0
    row[3] = (baseline.star[first:last] >= 0).sum()
    row[4], row[5] = 0.0, history.arcs[f]
    tally[FRAMES] += 1.0
    if history.arcs[f] > 0:
        row[4] = history.nis[f]
        most = _LARGEST_SHARE * history.arcs[f] * tally[NIS] / tally[DOF]
    event = _judge(state, rules, f, history, covariance)
    if history.arcs[f] > 0 and event != NUMERICAL:
        tally[NIS] += min(history.nis[f], most)
        tally[DOF] += history.arcs[f]
    history.event[f] = event
    if event != NOTHING:
        state.x[:], state.root[:, :] = state.start_x, state.start_root
        state.base_x[:], state.base_root[:, :] = state.start_x, state.start_root
        state.linearised_at[:] = state.start_x
        kept.place[:] = 0
        window[:, :] = 0.0
        tally[PROBATION] = window.shape[0]
    elif tally[PROBATION] > 0.0:
        tally[PROBATION] -= 1.0
    history.on_baseline[f] = tally[PROBATION] > 0.0


@kernel
def _judge(state, rules, f, history, covariance):
    """Return the event of the frame just counted."""
    if not np.isfinite(state.x).all() or not _is_positive_definite(covariance):
        return NUMERICAL
    if history.arcs[f] > 0 and not np.isfinite(history.nis[f] + history.log_determinant[f]):
        return NUMERICAL
    window, tally = state.window, state.tally
    total = np.zeros(WINDOW)
    for k in range(window.shape[0]):
        total += window[k]
    if rules.shadow:
        if total[1] - total[0] >= rules.lost_frames:
            return LOST_FRAMES
        # Probation lasts as long as the window takes to fill again.
        full = tally[FRAMES] >= window.shape[0] and tally[PROBATION] == 0.0
        if full and total[2] < (1.0 - rules.lost_star_share) * total[3]:
            return LOST_STARS
    if (window[:, 5] > 0.0).sum() >= _JUDGED_FRAMES:
        mean, usual = total[4] / total[5], tally[NIS] / tally[DOF]
        if mean > rules.divergence * usual or mean > rules.divergence_noise:
            return INNOVATIONS
    return NOTHING


@kernel
def _is_positive_definite(covariance):
    """Whether a Cholesky factor exists; the covariance is taken in units of its own sd."""
    n = covariance.shape[0]
    factor = np.zeros((n, n))
    for i in range(n):
        if not covariance[i, i] > 0.0 or not math.isfinite(covariance[i, i]):
            return False
    for i in range(n):
        for j in range(i + 1):
            value = covariance[i, j] / math.sqrt(covariance[i, i] * covariance[j, j])
            for k in range(j):
                value -= factor[i, k] * factor[j, k]
            if i > j:
                factor[i, j] = value / factor[j, j]
            elif not value > 0.0:
                return False
            else:
                factor[i, i] = math.sqrt(value)
    return True
