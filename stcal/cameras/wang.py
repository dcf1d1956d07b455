"""Camera model ``wang``: the ST-16's inverted form of Wang et al. 2008, Enright 2018 eqs (1)-(8).

Parameters x = [f, m0, n0, b4, b2, a1, a2, g_y]: focal length, principal point, radial
coefficients, linearised detector rotations (decentring and prism), pixel aspect.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stcal.cameras.base import CameraModel

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


def ray(x: Floats, pixel_size_m: float, m: Floats, n: Floats) -> Floats:
    """Return r_d (S, 3) [m] of centroids (S,) [px], Enright 2018 eqs (1)-(6)."""
    f, m0, n0, b4, b2, a1, a2, g_y = x
    u = pixel_size_m * (m - m0)
    v = g_y * pixel_size_m * (n - n0)
    tilt = f / (a1 * v + a2 * u + f)
    U, V = u * tilt, v * tilt
    rho2 = U * U + V * V
    B = 1.0 + rho2 * (b2 + rho2 * b4)
    return np.stack([B * U, B * V, np.full_like(U, f)], axis=-1)


def ray_jacobian(
    x: Floats, pixel_size_m: float, m: Floats, n: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return r_d (S, 3), dr/dx (S, 3, 8) and dr/d(m, n) (S, 3, 2).

    Enright 2018 Appendix B, eqs (41)-(77), with the common factors taken out: every parameter
    but b2 and b4 acts through (U, V), and dB = (4 b4 rho^3 + 2 b2 rho) drho.
    """
    f, m0, n0, b4, b2, a1, a2, g_y = x
    u = pixel_size_m * (m - m0)
    dn = pixel_size_m * (n - n0)
    v = g_y * dn
    tilt_sum = a1 * v + a2 * u
    denominator = tilt_sum + f
    d2 = denominator * denominator
    U, V = u * f / denominator, v * f / denominator
    rho2 = U * U + V * V
    B = 1.0 + rho2 * (b2 + rho2 * b4)
    slope = 2.0 * b2 + 4.0 * b4 * rho2  # (dB/drho) / rho

    U_u, U_v = f * (a1 * v + f) / d2, -a1 * u * f / d2
    V_u, V_v = -a2 * v * f / d2, f * (a2 * u + f) / d2
    zero = np.zeros_like(u)
    dU = np.stack(
        [u * tilt_sum / d2, -pixel_size_m * U_u, -pixel_size_m * g_y * U_v, zero, zero,
         -v * u * f / d2, -u * u * f / d2, dn * U_v, pixel_size_m * U_u,
         pixel_size_m * g_y * U_v],
        axis=-1,
    )  # fmt: skip
    dV = np.stack(
        [v * tilt_sum / d2, -pixel_size_m * V_u, -pixel_size_m * g_y * V_v, zero, zero,
         -v * v * f / d2, -v * u * f / d2, dn * V_v, pixel_size_m * V_u,
         pixel_size_m * g_y * V_v],
        axis=-1,
    )  # fmt: skip
    dB = slope[:, None] * (U[:, None] * dU + V[:, None] * dV)
    dB[:, 3] += rho2 * rho2
    dB[:, 4] += rho2
    jacobian = np.zeros((len(u), 3, 10))
    jacobian[:, 0] = dB * U[:, None] + B[:, None] * dU
    jacobian[:, 1] = dB * V[:, None] + B[:, None] * dV
    jacobian[:, 2, 0] = 1.0
    r = np.stack([B * U, B * V, np.full_like(U, f)], axis=-1)
    return r, jacobian[:, :, :8], jacobian[:, :, 8:]


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


WANG = CameraModel(
    name="wang",
    parameter_names=PARAMETER_NAMES,
    ray=ray,
    ray_jacobian=ray_jacobian,
    pixel_guess=pixel_guess,
    reference="Enright, Jovanovic & Vaz 2018, eqs (1)-(8), Appendix B",
)
