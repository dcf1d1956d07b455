"""Criteria A and B of Wu et al. 2019, section 4.1: errors of the separations of star pairs.

Each image has one root mean square error over all its pairs, of separations measured with a camera
against those by the catalogue: A from true centroids, B from measured ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.constants import ARCSEC
from stcal.residuals.arclength import separations
from stcal.studies.given import KnownImages

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Draws from which the distribution of a criterion is made.
_DRAWS = 2000


@dataclass(frozen=True)
class Pairs:
    """All star pairs of some images, as columns (K,), image after image.

    Attributes
    ----------
    first, second : the two stars, rows of the images' stars
    image : which image, 0..F-1
    angle : rad, separation by the catalogue
    n_images : F
    """

    first: Ints
    second: Ints
    image: Ints
    angle: Floats
    n_images: int

    def rmse_arcsec(self, s_d: Floats) -> Floats:
        """Return each image's RMSE (F,) with star vectors s_d (S, 3); NaN without a pair."""
        error = separations(s_d[self.first], s_d[self.second]) - self.angle
        squares = np.bincount(self.image, error * error, minlength=self.n_images)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.sqrt(squares / self.counts) / ARCSEC)

    @property
    def counts(self) -> Ints:
        """Number of pairs (F,) of each image."""
        return np.bincount(self.image, minlength=self.n_images)


def pairs_of(images: KnownImages) -> Pairs:
    """Return all pairs of each image's stars."""
    last = images.offsets[1:][images.image]
    partners = last - np.arange(len(last)) - 1
    first = np.repeat(np.arange(len(last)), partners)
    place = np.arange(len(first)) - np.repeat(np.cumsum(partners) - partners, partners)
    second = first + 1 + place
    angle = separations(images.s_i[first], images.s_i[second])
    return Pairs(first, second, images.image[first], angle, images.n_images)


def separation_rows(pairs: Pairs, s_d: Floats, by_parameter: Floats) -> tuple[Floats, Floats]:
    """Return derivatives (K, P) and errors (K,) of the separations [rad].

    From star vectors s_d (S, 3) and their derivatives (S, 3, P); Enright 2018 eq (38).
    """
    a, b = pairs.first, pairs.second
    angle = separations(s_d[a], s_d[b])
    cosine = np.einsum("kip,ki->kp", by_parameter[a], s_d[b])
    cosine += np.einsum("kip,ki->kp", by_parameter[b], s_d[a])
    return -cosine / np.sin(angle)[:, None], angle - pairs.angle


def quadratic_forms(pairs: Pairs, images: KnownImages, camera: Camera) -> Floats:
    """Return the mean square of criterion A in each image as a form (F, P, P) [rad^2].

    Of small errors of the camera's parameters; NaN for an image without a pair.
    """
    s_d, by_parameter, _ = camera.jacobian(images.row_px, images.col_px)
    rows, _ = separation_rows(pairs, s_d, by_parameter)
    counts, size = pairs.counts, rows.shape[1]
    forms = np.full((pairs.n_images, size, size), np.nan)
    some = counts > 0
    starts = (np.cumsum(counts) - counts)[some]
    products = np.add.reduceat(rows[:, :, None] * rows[:, None, :], starts, axis=0)
    forms[some] = products / counts[some][:, None, None]
    return forms


def distribution_arcsec(covariance: Floats, forms: Floats) -> Floats:
    """Return draws (D,) of criterion A, the mean over images, for a covariance (P, P)."""
    rng = np.random.default_rng(0)
    scale = np.sqrt(np.diag(covariance))
    root = np.linalg.cholesky(covariance / np.outer(scale, scale)) * scale[:, None]
    error = rng.normal(size=(_DRAWS, len(scale))) @ root.T
    squares = np.einsum("dp,fpq,dq->df", error, forms, error, optimize=True)
    return np.asarray(np.nanmean(np.sqrt(squares), axis=1) / ARCSEC)
