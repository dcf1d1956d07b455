"""From one kept telemetry frame to a measurement update of the state (numba)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stcal.cameras.noise_kernels import slopes_at
from stcal.estimators.filter_kernels import sigma_points
from stcal.jit import kernel
from stcal.residuals.screening_kernels import screen_exposure


@kernel
def camera_of(model, x, warmth, out):
    """Fill ``out`` (P,) with the camera parameters of a state at a temperature."""
    out[:] = model.reference
    for k in range(x.shape[0]):
        factor = model.scale[k] * (warmth if model.thermal[k] else 1.0)
        out[model.target[k]] += factor * x[k]


@kernel
def _by_state(model, warmth, by_parameter):
    """Return derivatives by the state (..., n) of ones by the camera parameters (K, 3, P)."""
    n = model.target.shape[0]
    out = np.empty((by_parameter.shape[0], 3, n))
    for k in range(n):
        factor = model.scale[k] * (warmth if model.thermal[k] else 1.0)
        for s in range(out.shape[0]):
            for i in range(3):
                out[s, i, k] = factor * by_parameter[s, i, model.target[k]]
    return out


@kernel
def _state_rows(model, warmth, full, before, at, out):
    """Fill ``out`` (A, n + 1) with [H | y], y = -(residual + H (before - at)).

    ``full`` (A, P + 1) was linearised at the state ``at``; the step counts from ``before``.
    """
    n, last = model.target.shape[0], full.shape[1] - 1
    for a in range(full.shape[0]):
        y = full[a, last]
        for k in range(n):
            factor = model.scale[k] * (warmth if model.thermal[k] else 1.0)
            out[a, k] = factor * full[a, model.target[k]]
            y += out[a, k] * (before[k] - at[k])
        out[a, n] = -y


class Chosen(NamedTuple):
    """The stars (K,) of a frame that a measurement is made of."""

    offsets: NDArray[np.int64]
    row_px: NDArray[np.float64]
    col_px: NDArray[np.float64]
    s_i: NDArray[np.float64]
    sd: NDArray[np.float64]


@kernel
def star_vectors(camera, model, values, row_px, col_px, sd_px):
    """Return s_d (K, 3), derivatives (K, 3, P) and sd [rad] (K,) of centroids."""
    count = row_px.shape[0]
    s_d, by_pixel = np.empty((count, 3)), np.empty((count, 3, 2))
    by_parameter = np.empty((count, 3, values.shape[0]))
    camera(values, model.pixel_size_m, row_px, col_px, s_d, by_parameter, by_pixel)
    sd = np.empty(count)
    for k in range(count):
        total = 0.0
        for i in range(3):
            total += by_pixel[k, i, 0] ** 2 + by_pixel[k, i, 1] ** 2
        sd[k] = sd_px[k] * math.sqrt(0.5 * total)
    return s_d, by_parameter, sd


@kernel
def _choose(camera, model, rules, kept, slot, judged, values, covariance, scale):
    """Screen the stars of a kept frame; return those to use and how many were rejected.

    They are judged with the camera ``judged`` (P,), of state covariance ``covariance``; their noise
    is that of the camera ``values``, where the measurement is linearised.
    """
    first, second = int(kept.facts[slot, 0]), int(kept.facts[slot, 1])
    total = first + second
    row_px, col_px = kept.star[slot, :total, 0].copy(), kept.star[slot, :total, 1].copy()
    s_i = kept.star[slot, :total, 2:5].copy()
    s_d, by_parameter, sd = star_vectors(
        camera, model, judged, row_px, col_px, kept.star[slot, :total, 5]
    )
    by_state = _by_state(model, kept.facts[slot, 2], by_parameter)
    use = np.ones(total, np.bool_)
    counts = np.zeros(3, np.int64)
    rejected = 0
    for e in range(2):
        a, b = (0, first) if e == 0 else (first, total)
        left = b - a
        if left >= rules.minimum_stars:
            left = screen_exposure(
                s_d[a:b], s_i[a:b], sd[a:b], by_state[a:b], covariance, scale,
                rules.rejection_sigma, kept.c_di[slot, e], use[a:b],
            )  # fmt: skip
            rejected += b - a - left
        if left < rules.minimum_stars:
            use[a:b] = False
            left = 0
        counts[1 + e] = left
    if not (judged == values).all():
        _, _, sd = star_vectors(camera, model, values, row_px, col_px, kept.star[slot, :total, 5])
    return Chosen(np.cumsum(counts), row_px[use], col_px[use], s_i[use], sd[use]), rejected


@kernel
def _linearise(camera, residual, model, warmth, bound, chosen, at, before, out):
    """Fill ``out`` (A, n + 1) with the whitened measurement, linearised at the state ``at``."""
    count, parameters = chosen.s_i.shape[0], model.reference.shape[0]
    values = np.empty(parameters)
    camera_of(model, at, warmth, values)
    s_d, by_pixel = np.empty((count, 3)), np.empty((count, 3, 2))
    by_parameter = np.empty((count, 3, parameters))
    camera(values, model.pixel_size_m, chosen.row_px, chosen.col_px, s_d, by_parameter, by_pixel)
    full = np.empty((out.shape[0], parameters + 1))
    residual(bound[0], bound[1], values, s_d, by_parameter, full)
    _state_rows(model, warmth, full, before, at, out)


@kernel
def _evaluate(camera, residual, model, warmth, bound, chosen, points, values):
    """Fill ``values`` (A, count) with whitened residuals at the states ``points`` (count, n)."""
    count, parameters = chosen.s_i.shape[0], model.reference.shape[0]
    at = np.empty(parameters)
    s_d, by_pixel = np.empty((count, 3)), np.empty((count, 3, 2))
    by_parameter, none = np.empty((count, 3, parameters)), np.empty((count, 3, 0))
    column = np.empty((values.shape[0], 1))
    for p in range(points.shape[0]):
        camera_of(model, points[p], warmth, at)
        camera(at, model.pixel_size_m, chosen.row_px, chosen.col_px, s_d, by_parameter, by_pixel)
        residual(bound[0], bound[1], at, s_d, none, column)
        values[:, p] = column[:, 0]


@kernel
def _on_a_plane(rows, x, points, values):
    """Fill ``values`` (A, count) with what linear residuals, ``rows`` [H | y] at x, give at points.

    For these the unscented update is Kalman's.
    """
    n = x.shape[0]
    for a in range(rows.shape[0]):
        for p in range(points.shape[0]):
            values[a, p] = -rows[a, n]
            for k in range(n):
                values[a, p] += rows[a, k] * (points[p, k] - x[k])


@kernel
def update_by_frame(
    functions, model, rules, kept, slot, at, judge, anew, x, root, covariance, scale, innovation,
    score,
):  # fmt: skip
    """Update the state by a kept frame, linearised at ``at``; its stars are judged by ``judge``.

    An unscented filter evaluates a new frame at its sigma points; one that is taken ``anew`` it
    linearises as the others do.  Returns the number of independent residuals, of innovations and
    of rejected stars.
    """
    camera, bind, residual, update = functions[:4]
    warmth, n = kept.facts[slot, 2], x.shape[0]
    values = np.empty(model.reference.shape[0])
    camera_of(model, at, warmth, values)
    judged = np.empty(values.shape[0])
    camera_of(model, judge, warmth, judged)
    chosen, rejected = _choose(camera, model, rules, kept, slot, judged, values, covariance, scale)
    if chosen.s_i.shape[0] == 0:
        return 0, 0, rejected
    slope = np.empty((chosen.s_i.shape[0], values.shape[0]))
    slopes_at(model.slope_table, model.rows, model.cols, chosen.row_px, chosen.col_px, slope)
    bound = bind(chosen.offsets, chosen.s_i, chosen.sd, slope, values, model.options)
    count = bound[0][0]
    if count == 0:
        return 0, 0, rejected
    rows, points = np.empty((count, n + 1)), np.empty((2 * n + 1, n))
    residuals = np.empty((count, 2 * n + 1))
    if rules.unscented and not anew:
        sigma_points(x, root, points)
        _evaluate(camera, residual, model, warmth, bound, chosen, points, residuals)
    else:
        _linearise(camera, residual, model, warmth, bound, chosen, at, x.copy(), rows)
        if rules.unscented:
            sigma_points(x, root, points)
            _on_a_plane(rows, x, points, residuals)
    update(rows, residuals, x, root, innovation[:count], score)
    return count - bound[0][1], count, rejected
