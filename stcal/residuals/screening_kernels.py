"""Which stars of one exposure neither noise nor the camera's own uncertainty explains (numba).

A filter's camera is uncertain at first and well known later: a star is judged by its departure from
the exposure's attitude against the sd of that departure, noise and camera taken together.
"""

from __future__ import annotations

import numpy as np

from stcal.geometry.symmetric_kernels import adjugate3
from stcal.jit import kernel
from stcal.matching.verify_kernels import refine_attitude, rotate

# A star that the attitude follows almost wholly tells little about itself.
_LEAST_FREEDOM = 0.1


@kernel
def screen_exposure(s, s_i, sd, by_state, covariance, scale, sigma, c, kept):
    """Unmark in ``kept`` (N,) the stars beyond ``sigma`` times their sd, the worst one at a time.

    s, s_i (N, 3) in D and I; sd (N,) rad; by_state (N, 3, n) tangential derivatives of s by the
    state with ``covariance`` (n, n), both to be multiplied by ``scale``^2; c (3, 3) an attitude
    near the solution, refined in place.  Returns the number of stars kept.
    """
    normal, inverse, middle = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    marks = np.empty(kept.shape[0], np.int32)
    b = np.empty(3)
    left = 0
    for k in range(kept.shape[0]):
        left += kept[k]
    for _ in range(kept.shape[0]):
        for k in range(kept.shape[0]):
            marks[k] = 0 if kept[k] else -1
        if left < 3 or not refine_attitude(s, s_i, marks, c):
            return left
        _attitude_normal(s, sd, kept, normal, middle)
        if not _invert(normal, inverse):
            return left
        turn = np.empty((0, 0))
        worst, worst_excess = -1, sigma * sigma
        for k in range(kept.shape[0]):
            if not kept[k]:
                continue
            rotate(c, s_i[k], b)
            d2 = (b[0] - s[k, 0]) ** 2 + (b[1] - s[k, 1]) ** 2 + (b[2] - s[k, 2]) ** 2
            # Per axis, as sigma is.
            expected = scale * scale * 0.5 * _noise_part(s[k], sd[k], inverse, middle)
            if d2 > worst_excess * expected:
                if turn.shape[0] == 0:
                    turn = _attitude_follows(s, by_state, kept, inverse)
                expected += scale * scale * 0.5 * _camera_part(s[k], by_state[k], turn, covariance)
                if d2 > worst_excess * expected:
                    worst, worst_excess = k, d2 / expected
        if worst < 0:
            return left
        kept[worst] = False
        left -= 1
    return left


@kernel
def _attitude_normal(s, sd, kept, normal, middle):
    """Fill A = sum (1 - s s^T) and sum sd^2 (1 - s s^T), both (3, 3)."""
    normal[:, :], middle[:, :] = 0.0, 0.0
    for k in range(s.shape[0]):
        if not kept[k]:
            continue
        for i in range(3):
            for j in range(3):
                term = (1.0 if i == j else 0.0) - s[k, i] * s[k, j]
                normal[i, j] += term
                middle[i, j] += sd[k] * sd[k] * term


@kernel
def _invert(a, out):
    """Invert a symmetric 3 x 3 matrix; returns False when it is singular."""
    det = adjugate3(a, out)
    if not abs(det) > 1e-12:
        return False
    out[:, :] /= det
    return True


@kernel
def _noise_part(s, sd, inverse, middle):
    """E|r|^2 of a star by centroid noise, the unweighted attitude following it a little.

    2 sd^2 - 2 sd^2 tr(A^-1 M) + tr(A^-1 B A^-1 M), M = 1 - s s^T, B = sum sd^2 M.
    """
    own, others = 0.0, 0.0
    for i in range(3):
        for j in range(3):
            m = (1.0 if i == j else 0.0) - s[i] * s[j]
            own += inverse[i, j] * m
            for p in range(3):
                for q in range(3):
                    others += inverse[i, p] * middle[p, q] * inverse[q, j] * m
    return max(2.0 * sd * sd * (1.0 - own) + others, 2.0 * sd * sd * _LEAST_FREEDOM)


@kernel
def _attitude_follows(s, by_state, kept, inverse):
    """Return (3, n) the turn of the attitude by the state: A^-1 sum s x (ds/dx)."""
    n = by_state.shape[2]
    total = np.zeros((3, n))
    for k in range(s.shape[0]):
        if not kept[k]:
            continue
        for i in range(3):
            j, p = (i + 1) % 3, (i + 2) % 3
            for q in range(n):
                total[i, q] += s[k, j] * by_state[k, p, q] - s[k, p] * by_state[k, j, q]
    turn = np.zeros((3, n))
    for i in range(3):
        for j in range(3):
            for q in range(n):
                turn[i, q] += inverse[i, j] * total[j, q]
    return turn


@kernel
def _camera_part(s, by_state, turn, covariance):
    """E|r|^2 of a star by the state's uncertainty: tr(G P G^T), G = ds/dx - turn x s."""
    n = by_state.shape[1]
    total = 0.0
    g = np.empty(n)
    for i in range(3):
        j, p = (i + 1) % 3, (i + 2) % 3
        for q in range(n):
            g[q] = by_state[i, q] - (turn[j, q] * s[p] - turn[p, q] * s[j])
        for q in range(n):
            for r in range(n):
                total += g[q] * covariance[q, r] * g[r]
    return total
