"""The Cramer-Rao bound of a calibration, from centroids with each image's attitude projected out.

It is that of the pixel measurement itself: no residual, however it is formed, can do better.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.studies.given import KnownImages

Floats = NDArray[np.float64]


def image_information(images: KnownImages, camera: Camera, sd_px: float, scale: Floats) -> Floats:
    """Return what each image tells about the camera, (F, P, P).

    Parameters
    ----------
    images : with the camera's true centroids
    camera : the true camera
    sd_px : centroid noise per axis
    scale : (P,) units of the parameters that the information is in
    """
    by_parameter, by_attitude = pixel_jacobians(camera, images.row_px, images.col_px)
    both = np.concatenate([by_parameter * scale, by_attitude], axis=2) / sd_px
    total = _sum_by_image(np.einsum("kip,kiq->kpq", both, both), images)
    n = len(scale)
    camera_part, mixed, attitude = total[:, :n, :n], total[:, :n, n:], total[:, n:, n:]
    # An image with too few stars to fix its attitude tells nothing here.
    followed = mixed @ np.linalg.pinv(attitude, hermitian=True)
    return np.asarray(camera_part - followed @ np.swapaxes(mixed, 1, 2))


def pixel_jacobians(camera: Camera, row_px: Floats, col_px: Floats) -> tuple[Floats, Floats]:
    """Return d(m, n)/dx (K, 2, P) and d(m, n)/de (K, 2, 3), e a turn of the star about D's axes.

    By the implicit function theorem, the star's direction being given.
    """
    s, by_parameter, by_pixel = camera.jacobian(row_px, col_px)
    inverse = np.linalg.pinv(by_pixel)
    turned = np.swapaxes(np.cross(np.eye(3), s[:, None, :]), 1, 2)
    return np.asarray(-inverse @ by_parameter), np.asarray(inverse @ turned)


def bound_over_images(information: Floats, prior: Floats | None = None) -> Floats:
    """Return the bound (F, P, P) on the covariance after each image.

    ``information`` (F, P, P) is that of each image, ``prior`` (P, P) what is known before; NaN
    while the images do not fix the camera.
    """
    total = np.cumsum(information, axis=0)
    if prior is not None:
        total = total + prior
    good = np.linalg.cond(total) < 1e12
    bound = np.full(total.shape, np.nan)
    bound[good] = np.linalg.inv(total[good])
    return bound


def _sum_by_image(terms: Floats, images: KnownImages) -> Floats:
    """Sum (K, A, B) by image (F, A, B)."""
    first, last = images.offsets[:-1], images.offsets[1:]
    running = np.concatenate([np.zeros((1, *terms.shape[1:])), np.cumsum(terms, axis=0)])
    return np.asarray(running[last] - running[first])
