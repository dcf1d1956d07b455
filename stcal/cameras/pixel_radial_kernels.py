"""Camera model ``pixel-radial`` compiled: the arithmetic is that of stcal.cameras.pixel_radial."""

from __future__ import annotations

from stcal.cameras import pixel_radial
from stcal.cameras.unit_kernels import CAMERA_SIGNATURE, unit
from stcal.jit import kernel, pointer

ray_jacobian = kernel(pixel_radial.ray_jacobian)


@pointer(CAMERA_SIGNATURE)
def evaluate(x, pixel_size_m, m, n, s, by_parameter, by_pixel):
    """Fill unit vectors (N, 3) of centroids (N,) and their derivatives, as Camera.jacobian."""
    for i in range(len(m)):
        r, r_by_parameter, r_by_pixel = ray_jacobian(x, pixel_size_m, m[i], n[i])
        unit(r, r_by_parameter, r_by_pixel, i, s, by_parameter, by_pixel)
