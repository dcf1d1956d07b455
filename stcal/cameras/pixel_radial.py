"""Camera model ``pixel-radial``: radial distortion in pixels, Zhang et al. 2024 eqs (13)-(17).

Parameters x = [x0, y0, f, k1, k2]; the image's x runs along the rows m and y along the columns n,
as the axes of D.  A centroid is first moved to its ideal place, x_hat = x + (x - x0) (k1 r^2 +
k2 r^4) with r in pixels (k1 in px^-2, k2 in px^-4), which is taken as the definition; then it is
a pinhole's, without image inversion.

``ray`` and ``ray_jacobian`` serve numpy (whole columns) and numba (one star).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stcal.cameras.base import CameraModel, Ray, RayDerivatives

Floats = NDArray[np.float64]

PARAMETER_NAMES = ("x0_px", "y0_px", "f_m", "k1_per_px2", "k2_per_px4")


def ray(x: Floats, pixel_size_m: float, m: Floats, n: Floats) -> Ray:
    """Return r_d [px] of centroids [px], Zhang 2024 eqs (13)-(17)."""
    dx, dy = m - x[0], n - x[1]
    r2 = dx * dx + dy * dy
    stretch = 1.0 + r2 * (x[3] + r2 * x[4])
    return dx * stretch, dy * stretch, x[2] / pixel_size_m


def ray_jacobian(x: Floats, pixel_size_m: float, m: Floats, n: Floats) -> RayDerivatives:
    """Return r_d, dr/dx (3 x 5) and dr/d(m, n) (3 x 2)."""
    dx, dy = m - x[0], n - x[1]
    r2 = dx * dx + dy * dy
    k1, k2 = x[3], x[4]
    stretch = 1.0 + r2 * (k1 + r2 * k2)
    slope = 2.0 * k1 + 4.0 * k2 * r2  # (dstretch/dr) / r
    X_x, X_y, Y_y = stretch + slope * dx * dx, slope * dx * dy, stretch + slope * dy * dy
    by_parameter = (
        (-X_x, -X_y, 0.0, dx * r2, dx * r2 * r2),
        (-X_y, -Y_y, 0.0, dy * r2, dy * r2 * r2),
        (0.0, 0.0, 1.0 / pixel_size_m, 0.0, 0.0),
    )
    by_pixel = ((X_x, X_y), (X_y, Y_y), (0.0, 0.0))
    return (dx * stretch, dy * stretch, x[2] / pixel_size_m), by_parameter, by_pixel


def pixel_guess(x: Floats, pixel_size_m: float, s_d: Floats) -> tuple[Floats, Floats]:
    """Return starting centroids for the inverse: the ideal places moved back by fixed point."""
    with np.errstate(all="ignore"):
        scale = x[2] / pixel_size_m
        X, Y = scale * s_d[:, 0] / s_d[:, 2], scale * s_d[:, 1] / s_d[:, 2]
        r2 = X * X + Y * Y
        stretch = np.ones_like(r2)
        for _ in range(5):
            d2 = r2 / (stretch * stretch)
            stretch = 1.0 + d2 * (x[3] + d2 * x[4])
    return x[0] + X / stretch, x[1] + Y / stretch


def undistorted(f_m: float, m0_px: float, n0_px: float) -> Floats:
    """Return the parameters of a plain pinhole with this principal point."""
    return np.array([m0_px, n0_px, f_m, 0.0, 0.0])


PIXEL_RADIAL = CameraModel(
    name="pixel-radial",
    parameter_names=PARAMETER_NAMES,
    ray=ray,
    ray_jacobian=ray_jacobian,
    pixel_guess=pixel_guess,
    undistorted=undistorted,
    reference="Zhang et al. 2024, eqs (13)-(17)",
)
