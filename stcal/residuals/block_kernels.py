"""A residual on a block of exposures, from centroids to a triangular factor (numba).

Camera and residual come in as function pointers, so that one compiled function serves all of them.
A block's star vectors and their derivatives stay in the processor's cache; those of a whole
fragment would pass through memory, which takes longer than to compute them.
"""

from __future__ import annotations

import math

import numpy as np
from numba import float64, int64, types, void

from stcal.cameras.noise_kernels import noise_scale, slopes_at
from stcal.cameras.unit_kernels import CAMERA_SIGNATURE
from stcal.jit import kernel, pointer
from stcal.residuals.contract_kernels import BIND, ROWS

# Rows that are reflected at once: their columns are then contiguous, in the nearest cache.
_TILE = 48

_NUMBERS, _COLUMN, _TABLE = int64[::1], float64[::1], float64[:, ::1]


@kernel
def _star_vectors(camera, x, pixel_size_m, row_px, col_px):
    """Return s_d (K, 3) and its derivatives (K, 3, P) and (K, 3, 2)."""
    count = row_px.shape[0]
    s_d, by_pixel = np.empty((count, 3)), np.empty((count, 3, 2))
    by_parameter = np.empty((count, 3, x.shape[0]))
    camera(x, pixel_size_m, row_px, col_px, s_d, by_parameter, by_pixel)
    return s_d, by_parameter, by_pixel


def _bind_block(
    camera, bind, x, pixel_size_m, slope_table, rows, cols, offsets, row_px, col_px, s_i, sd_px,
    options,
):  # fmt: skip
    """Bind a residual to stars (K,) of exposures, their noise in rad being that of the camera."""
    _, _, by_pixel = _star_vectors(camera, x, pixel_size_m, row_px, col_px)
    sd, slope = np.empty(row_px.shape[0]), np.empty((row_px.shape[0], x.shape[0]))
    for k in range(row_px.shape[0]):
        sd[k] = sd_px[k] * noise_scale(by_pixel, k)
    slopes_at(slope_table, rows, cols, row_px, col_px, slope)
    return bind(offsets, s_i, sd, slope, x, options)


bind_block = pointer(
    types.Tuple((_NUMBERS, _COLUMN))(
        types.FunctionType(CAMERA_SIGNATURE), types.FunctionType(BIND), _COLUMN, float64,
        float64[:, :, ::1], float64, float64, _NUMBERS, _COLUMN, _COLUMN, _TABLE, _COLUMN, _COLUMN,
    )
)(_bind_block)  # fmt: skip


@kernel
def _reflect(tile, factor):
    """Householder's QR of the factor above a tile of rows, given by columns (W, A); it is spoilt.

    Each reflection takes a row of the triangle and all of the tile (Golub & Van Loan, 5.1).
    """
    width, count = tile.shape
    for k in range(width):
        norm2 = factor[k, k] * factor[k, k]
        for i in range(count):
            norm2 += tile[k, i] * tile[k, i]
        norm = -math.sqrt(norm2) if factor[k, k] > 0.0 else math.sqrt(norm2)
        if norm == 0.0:
            continue
        head = factor[k, k] - norm
        scale = -1.0 / (norm * head)
        factor[k, k] = norm
        for j in range(k + 1, width):
            dot = head * factor[k, j]
            for i in range(count):
                dot += tile[k, i] * tile[j, i]
            dot *= scale
            factor[k, j] -= head * dot
            for i in range(count):
                tile[j, i] -= tile[k, i] * dot


@kernel
def fold(rows, columns, factor):
    """Fold columns of rows (A, ...) into an upper triangular factor (W, W), tile by tile."""
    width = factor.shape[0]
    tile = np.empty((width, _TILE))
    for first in range(0, rows.shape[0], _TILE):
        count = min(_TILE, rows.shape[0] - first)
        for i in range(count):
            for j in range(width):
                tile[j, i] = rows[first + i, columns[j]]
        _reflect(tile[:, :count], factor)


def _reduce_block(
    camera, rows, ints, floats, x, pixel_size_m, row_px, col_px, columns, factor
):  # fmt: skip
    """Fold the whitened rows of a block at the camera parameters x into ``factor`` (W, W).

    ``columns`` (W,) are those of [H | residual] that the factor has.
    """
    s_d, by_parameter, _ = _star_vectors(camera, x, pixel_size_m, row_px, col_px)
    out = np.empty((ints[0], x.shape[0] + 1))
    rows(ints, floats, x, s_d, by_parameter, out)
    fold(out, columns, factor)


reduce_block = pointer(
    void(
        types.FunctionType(CAMERA_SIGNATURE), types.FunctionType(ROWS), _NUMBERS, _COLUMN, _COLUMN,
        float64, _COLUMN, _COLUMN, _NUMBERS, _TABLE,
    )
)(_reduce_block)  # fmt: skip
