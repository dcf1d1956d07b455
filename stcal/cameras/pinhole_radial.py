"""Camera model ``pinhole-radial``: pinhole with dimensionless radial distortion, Wu et al. 2019.

Parameters x = [aspect, f, u0, v0, k1, k2] (Wu's s, f, u0, v0, k1, k2).  The image's u runs along
the columns n and v along the rows m; a pixel is pixel_size wide (u) and aspect * pixel_size high
(v), eqs (2)-(4).  The forward map adds the distortion to coordinates about the principal point
(the printed eq (6) forgets that they are), eqs (5)-(7): q_d = q (1 + k1 r^2 + k2 r^4) with
q = (X, Y) / Z.  From centroid to direction it is therefore inverted numerically.

``ray`` and ``ray_jacobian`` serve numpy (whole columns) and numba (one star).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stcal.cameras.base import CameraModel, Component, Ray, RayDerivatives

Floats = NDArray[np.float64]

PARAMETER_NAMES = ("aspect", "f_m", "u0_px", "v0_px", "k1", "k2")

# Newton steps on the radius: four reach rounding for a distortion of 10 %, eight do for 50 %.
_STEPS = 8


def shrink(d2: Component, k1: Component, k2: Component) -> Component:
    """Return r / r_d of the undistorted and the distorted radius, from r_d squared.

    Newton's method on t (1 + k1 d2 t^2 + k2 d2^2 t^4) = 1 with t = r / r_d.
    """
    t = 1.0 + 0.0 * d2
    a, b = k1 * d2, k2 * d2 * d2
    for _ in range(_STEPS):
        t2 = t * t
        t = t - (t * (1.0 + t2 * (a + t2 * b)) - 1.0) / (1.0 + t2 * (3.0 * a + 5.0 * t2 * b))
    return t


def ray(x: Floats, pixel_size_m: float, m: Floats, n: Floats) -> Ray:
    """Return r_d of centroids [px]: the undistorted slopes and one, Wu 2019 eq (8)."""
    scale = pixel_size_m / x[1]
    p, q = scale * x[0] * (m - x[3]), scale * (n - x[2])
    t = shrink(p * p + q * q, x[4], x[5])
    return p * t, q * t, 1.0


def ray_jacobian(x: Floats, pixel_size_m: float, m: Floats, n: Floats) -> RayDerivatives:
    """Return r_d, dr/dx (3 x 6) and dr/d(m, n) (3 x 2).

    With distorted slopes (p, q), d2 = p^2 + q^2 and t(d2, k1, k2) by implicit differentiation of
    t (1 + k1 d2 t^2 + k2 d2^2 t^4) = 1: ``slope`` is 2 dt/d(d2), so that dt = slope (p dp + q dq).
    """
    aspect, f = x[0], x[1]
    scale = pixel_size_m / f
    dm, dn = m - x[3], n - x[2]
    p, q = scale * aspect * dm, scale * dn
    d2 = p * p + q * q
    k1, k2 = x[4], x[5]
    t = shrink(d2, k1, k2)
    t2 = t * t
    a, b = k1 * d2, k2 * d2 * d2
    # Derivative of the equation by t.
    by_t = 1.0 + t2 * (3.0 * a + 5.0 * t2 * b)
    t3 = t2 * t
    slope = -2.0 * t3 * (k1 + 2.0 * k2 * d2 * t2) / by_t
    t_k1, t_k2 = -t3 * d2 / by_t, -t3 * t2 * d2 * d2 / by_t
    X_p, X_q, Y_q = t + slope * p * p, slope * p * q, t + slope * q * q  # Y_p = X_q
    p_m, q_n = scale * aspect, scale
    X_f, Y_f = -(X_p * p + X_q * q) / f, -(X_q * p + Y_q * q) / f
    by_parameter = (
        (X_p * scale * dm, X_f, -X_q * q_n, -X_p * p_m, p * t_k1, p * t_k2),
        (X_q * scale * dm, Y_f, -Y_q * q_n, -X_q * p_m, q * t_k1, q * t_k2),
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    )
    by_pixel = ((X_p * p_m, X_q * q_n), (X_q * p_m, Y_q * q_n), (0.0, 0.0))
    return (p * t, q * t, 1.0), by_parameter, by_pixel


def pixel_guess(x: Floats, pixel_size_m: float, s_d: Floats) -> tuple[Floats, Floats]:
    """Return centroids of directions: the forward map itself, Wu 2019 eqs (1)-(7)."""
    with np.errstate(all="ignore"):
        X, Y = s_d[:, 0] / s_d[:, 2], s_d[:, 1] / s_d[:, 2]
        r2 = X * X + Y * Y
        stretch = (1.0 + r2 * (x[4] + r2 * x[5])) * x[1] / pixel_size_m
        return x[3] + X * stretch / x[0], x[2] + Y * stretch


def undistorted(f_m: float, m0_px: float, n0_px: float) -> Floats:
    """Return the parameters of a plain pinhole with this principal point."""
    return np.array([1.0, f_m, n0_px, m0_px, 0.0, 0.0])


PINHOLE_RADIAL = CameraModel(
    name="pinhole-radial",
    parameter_names=PARAMETER_NAMES,
    ray=ray,
    ray_jacobian=ray_jacobian,
    pixel_guess=pixel_guess,
    undistorted=undistorted,
    reference="Wu, Xu, Wang, Liu & Gao 2019, eqs (1)-(8)",
)
