"""Camera model ``wang``: the ST-16's inverted form of Wang et al. 2008, Enright 2018 eqs (1)-(8).

Parameters x = [f, m0, n0, b4, b2, a1, a2, g_y]: focal length, principal point, radial
coefficients, linearised detector rotations (decentring and prism), pixel aspect.

``ray`` and ``ray_jacobian`` serve numpy (whole columns) and numba (one star, see wang_kernels).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stcal.cameras.base import CameraModel, Ray, RayDerivatives

Floats = NDArray[np.float64]

PARAMETER_NAMES = (
    "f_m",
    "m0_px",
    "n0_px",
    "b4_per_m4",
    "b2_per_m2",
    "a1_rad",
    "a2_rad",
    "g_y",
)


def ray(x: Floats, pixel_size_m: float, m: Floats, n: Floats) -> Ray:
    """Return r_d [m] of centroids [px], Enright 2018 eqs (1)-(6)."""
    f, m0, n0, b4, b2, a1, a2, g_y = x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7]
    u = pixel_size_m * (m - m0)
    v = g_y * pixel_size_m * (n - n0)
    tilt = f / (a1 * v + a2 * u + f)
    U, V = u * tilt, v * tilt
    rho2 = U * U + V * V
    B = 1.0 + rho2 * (b2 + rho2 * b4)
    return B * U, B * V, f


def ray_jacobian(x: Floats, pixel_size_m: float, m: Floats, n: Floats) -> RayDerivatives:
    """Return r_d, dr/dx (3 x 8) and dr/d(m, n) (3 x 2).

    Enright 2018 Appendix B, eqs (41)-(77), by the chain rule: ``tilt`` = f / (a1 v + a2 u + f),
    (U, V) = tilt (u, v), (X, Y) = B (U, V) with dB = (4 b4 rho^3 + 2 b2 rho) drho.  ``X_u`` is
    dX/du, and so on.
    """
    f, m0, n0, b4, b2, a1, a2, g_y = x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7]
    u, dn = pixel_size_m * (m - m0), pixel_size_m * (n - n0)
    v = g_y * dn
    tilt_sum = a1 * v + a2 * u
    tilt = f / (tilt_sum + f)
    tilt_f = tilt_sum / ((tilt_sum + f) * (tilt_sum + f))
    tilt_slope = -tilt / (tilt_sum + f)  # dtilt / dtilt_sum
    tilt_u, tilt_v = tilt_slope * a2, tilt_slope * a1
    tilt_a1, tilt_a2 = tilt_slope * v, tilt_slope * u

    U, V = u * tilt, v * tilt
    rho2 = U * U + V * V
    B = 1.0 + rho2 * (b2 + rho2 * b4)
    slope = 2.0 * b2 + 4.0 * b4 * rho2  # (dB/drho) / rho
    X_U, X_V, Y_V = B + slope * U * U, slope * U * V, B + slope * V * V  # Y_U = X_V
    X_tilt, Y_tilt = X_U * u + X_V * v, X_V * u + Y_V * v
    X_m = pixel_size_m * (X_U * tilt + X_tilt * tilt_u)
    Y_m = pixel_size_m * (X_V * tilt + Y_tilt * tilt_u)
    X_v, Y_v = X_V * tilt + X_tilt * tilt_v, Y_V * tilt + Y_tilt * tilt_v
    X_n, Y_n = pixel_size_m * g_y * X_v, pixel_size_m * g_y * Y_v

    X_b2, Y_b2 = rho2 * U, rho2 * V
    by_parameter = (
        (X_tilt * tilt_f, -X_m, -X_n, rho2 * X_b2, X_b2,
         X_tilt * tilt_a1, X_tilt * tilt_a2, dn * X_v),
        (Y_tilt * tilt_f, -Y_m, -Y_n, rho2 * Y_b2, Y_b2,
         Y_tilt * tilt_a1, Y_tilt * tilt_a2, dn * Y_v),
        (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    )  # fmt: skip
    return (B * U, B * V, f), by_parameter, ((X_m, X_n), (Y_m, Y_n), (0.0, 0.0))


def pixel_guess(x: Floats, pixel_size_m: float, s_d: Floats) -> tuple[Floats, Floats]:
    """Return starting centroids for the inverse: the closed form with B by fixed point.

    U, V = f (x, y) / (z B(rho)); then D = f / (1 - (a1 V + a2 U) / f), u = U D / f, v = V D / f.
    """
    f, m0, n0, b4, b2, a1, a2, g_y = x
    with np.errstate(all="ignore"):
        X, Y = f * s_d[:, 0] / s_d[:, 2], f * s_d[:, 1] / s_d[:, 2]
        r2 = X * X + Y * Y
        B = np.ones_like(r2)
        for _ in range(5):
            rho2 = r2 / (B * B)
            B = 1.0 + rho2 * (b2 + rho2 * b4)
        U, V = X / B, Y / B
        scale = 1.0 / (1.0 - (a1 * V + a2 * U) / f)
    return m0 + U * scale / pixel_size_m, n0 + V * scale / (g_y * pixel_size_m)


def undistorted(f_m: float, m0_px: float, n0_px: float) -> Floats:
    """Return the parameters of a plain pinhole with this principal point."""
    return np.array([f_m, m0_px, n0_px, 0.0, 0.0, 0.0, 0.0, 1.0])


WANG = CameraModel(
    name="wang",
    parameter_names=PARAMETER_NAMES,
    ray=ray,
    ray_jacobian=ray_jacobian,
    pixel_guess=pixel_guess,
    undistorted=undistorted,
    reference="Enright, Jovanovic & Vaz 2018, eqs (1)-(8), Appendix B",
)
