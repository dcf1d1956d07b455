"""Centroid noise of Zhang et al. 2024, eqs (9)-(10): NEA, white, and LFE, of low frequency.

The paper says no more of the LFE than its name.  Here it has two parts, each a first-order
Gauss-Markov process: a displacement of the whole image, and a distortion of the field.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from stcal.cameras import Camera
from stcal.studies.given import KnownImages
from stcal.studies.zhang_paper import NOISE_SD_PX

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class CentroidNoise:
    """Noise of the centroids, sd per axis [px].

    Attributes
    ----------
    white : independent from star to star (NEA)
    common : of the displacement of the image (LFE)
    field : RMS over the detector of the distortion (LFE), quadratic in the place
    time_constant_s : of both parts of the LFE
    """

    white: float = NOISE_SD_PX
    common: float = 0.0
    field: float = 0.0
    time_constant_s: float = 60.0


# The terms of a distortion that is quadratic in the place (u, v) in -1..1, each with mean zero and
# mean square one over the detector.  What is constant or linear acts as a common displacement, a
# roll or another focal length.
_UNIT_SQUARE, _UNIT_PRODUCT = np.sqrt(45.0 / 4.0), 3.0


def draw_errors(
    noise: CentroidNoise, images: KnownImages, camera: Camera, rng: np.random.Generator
) -> Floats:
    """Return centroid errors (2, K) [px], along rows and columns."""
    # Star by star, so that a shorter stretch of images begins with the same errors.
    error = noise.white * rng.normal(size=(len(images.star), 2)).T
    if noise.common:
        error += noise.common * gauss_markov(images.t_s, noise, (2,), rng)[images.image].T
    if noise.field:
        terms = _quadratic(camera, images)
        share = noise.field / np.sqrt(terms.shape[1])
        weights = share * gauss_markov(images.t_s, noise, (2, terms.shape[1]), rng)
        error += np.einsum("kat,kt->ak", weights[images.image], terms)
    return error


def gauss_markov(
    t_s: Floats, noise: CentroidNoise, size: tuple[int, ...], rng: np.random.Generator
) -> Floats:
    """Return stationary first-order Gauss-Markov processes (F, *size) of unit sd.

    ``t_s`` (F,) are evenly spaced times.
    """
    kept = np.exp(-(t_s[1] - t_s[0]) / noise.time_constant_s)
    drive = rng.normal(size=(len(t_s), *size))
    # The first value is drawn from the stationary distribution itself.
    drive[1:] *= np.sqrt(1.0 - kept * kept)
    return np.asarray(lfilter([1.0], [1.0, -kept], drive, axis=0))


def _quadratic(camera: Camera, images: KnownImages) -> Floats:
    """Return the quadratic terms (K, 3) at the stars' places."""
    u = 2.0 * (images.row_px + 0.5) / camera.rows - 1.0
    v = 2.0 * (images.col_px + 0.5) / camera.cols - 1.0
    square = (_UNIT_SQUARE * (w * w - 1.0 / 3.0) for w in (u, v))
    return np.stack([*square, _UNIT_PRODUCT * u * v], axis=1)
