"""How the noise of star vectors changes with the camera's parameters: a table of slopes (numba)."""

from __future__ import annotations

import math

import numpy as np
from numba import float64, types

from stcal.cameras.unit_kernels import CAMERA_SIGNATURE
from stcal.jit import kernel, pointer

_STEP_RAD = 1e-4


@kernel
def noise_scale(by_pixel, k):
    """Return the direction error [rad] per pixel of centroid error of star k, as Camera's."""
    total = 0.0
    for i in range(3):
        total += by_pixel[k, i, 0] * by_pixel[k, i, 0] + by_pixel[k, i, 1] * by_pixel[k, i, 1]
    return math.sqrt(0.5 * total)


@kernel
def _log_noise(camera, x, pixel_size_m, m, n, by_parameter, out):
    """Fill the logarithm of the direction error (K,) per pixel of centroid error, and ds/dx."""
    s_d, by_pixel = np.empty((m.shape[0], 3)), np.empty((m.shape[0], 3, 2))
    camera(x, pixel_size_m, m, n, s_d, by_parameter, by_pixel)
    for k in range(m.shape[0]):
        out[k] = math.log(noise_scale(by_pixel, k))


def _slope_table(camera, x, pixel_size_m, rows, cols, table):
    """Fill ``table`` (N, N, P) with derivatives of the logarithm of the noise by the parameters.

    Central differences over steps that move directions by some 0.1 mrad, on a grid over the
    detector from edge to edge: the slopes are smooth, and they only correct R.
    """
    nodes, parameters = table.shape[0], x.shape[0]
    count = nodes * nodes
    m, n = np.empty(count), np.empty(count)
    for i in range(nodes):
        for j in range(nodes):
            m[i * nodes + j] = i * rows / (nodes - 1.0) - 0.5
            n[i * nodes + j] = j * cols / (nodes - 1.0) - 0.5
    by_parameter, unused = np.empty((count, 3, parameters)), np.empty((count, 3, parameters))
    up, down = np.empty(count), np.empty(count)
    _log_noise(camera, x, pixel_size_m, m, n, by_parameter, up)
    table[:, :, :] = 0.0
    for p in range(parameters):
        moved = math.sqrt((by_parameter[:, :, p] ** 2).sum() / count)
        if moved == 0.0:
            continue
        step, there = _STEP_RAD / moved, x.copy()
        there[p] = x[p] + step
        _log_noise(camera, there, pixel_size_m, m, n, unused, up)
        there[p] = x[p] - step
        _log_noise(camera, there, pixel_size_m, m, n, unused, down)
        for i in range(nodes):
            for j in range(nodes):
                table[i, j, p] = (up[i * nodes + j] - down[i * nodes + j]) / (2.0 * step)


# camera, x (P,), pixel_size_m, rows, cols, table (N, N, P)
slope_table = pointer(
    types.void(
        types.FunctionType(CAMERA_SIGNATURE), float64[::1], float64, float64, float64,
        float64[:, :, ::1],
    )
)(_slope_table)  # fmt: skip


@kernel
def slopes_at(table, rows, cols, m, n, out):
    """Fill ``out`` (K, P) with slopes at centroids (K,), bilinear in a table (N, N, P).

    The table spans the detector from edge to edge; beyond its rim it goes on linearly.
    """
    nodes = table.shape[0]
    for k in range(m.shape[0]):
        x, y = (m[k] + 0.5) * (nodes - 1) / rows, (n[k] + 0.5) * (nodes - 1) / cols
        i, j = min(max(int(x), 0), nodes - 2), min(max(int(y), 0), nodes - 2)
        u, v = x - i, y - j
        for p in range(table.shape[2]):
            low = (1.0 - v) * table[i, j, p] + v * table[i, j + 1, p]
            high = (1.0 - v) * table[i + 1, j, p] + v * table[i + 1, j + 1, p]
            out[k, p] = (1.0 - u) * low + u * high
