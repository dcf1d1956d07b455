"""What all compiled cameras share: their signature, and the step from rays to unit vectors."""

from __future__ import annotations

from math import sqrt

from numba import types

from stcal.jit import kernel

_ROW = types.float64[::1]

# (x (P,), pixel_size_m, m (N,), n (N,), s_d (N, 3), ds_d/dx (N, 3, P), ds_d/d(m, n) (N, 3, 2)):
# fills the last three.
CAMERA_SIGNATURE = types.void(
    _ROW,
    types.float64,
    _ROW,
    _ROW,
    types.float64[:, ::1],
    types.float64[:, :, ::1],
    types.float64[:, :, ::1],
)


@kernel
def unit(r, by_parameter, by_pixel, i, s, s_by_parameter, s_by_pixel):
    """Write row i of the unit vectors and their derivatives, from tuples of ``ray_jacobian``.

    Rows are addressed by number: a view of each would double the time.
    """
    x, y, z = r
    scale = 1.0 / sqrt(x * x + y * y + z * z)
    x, y, z = x * scale, y * scale, z * scale
    s[i, 0], s[i, 1], s[i, 2] = x, y, z
    tangential(x, y, z, scale, by_parameter, i, s_by_parameter)
    tangential(x, y, z, scale, by_pixel, i, s_by_pixel)


@kernel
def tangential(x, y, z, scale, derivative, i, out):
    """Write row i of derivatives (N, 3, K), Enright 2018 eq (40): ds = (I - s s^T) dr / r."""
    for k in range(len(derivative[0])):
        dx, dy, dz = derivative[0][k], derivative[1][k], derivative[2][k]
        along = x * dx + y * dy + z * dz
        out[i, 0, k] = (dx - x * along) * scale
        out[i, 1, k] = (dy - y * along) * scale
        out[i, 2, k] = (dz - z * along) * scale
