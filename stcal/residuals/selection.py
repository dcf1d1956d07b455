"""The matched stars that a fit uses: enough of them in each exposure, without outliers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.config import Noise
from stcal.frames import MatchedFrames

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class StarSelection:
    """Matched stars of usable exposures, exposure by exposure.

    Attributes
    ----------
    star : (K,) index of each into the batch's detections
    exposure : (K,) which usable exposure, 0..X-1, rising
    row_px, col_px : (K,) centroids
    s_i : (K, 3) apparent directions in I
    sd_px : (K,) centroid noise, one sigma per axis
    n_exposures : X
    """

    star: Ints
    exposure: Ints
    row_px: Floats
    col_px: Floats
    s_i: Floats
    sd_px: Floats
    n_exposures: int

    @cached_property
    def offsets(self) -> Ints:
        """(X + 1,) ranges of the exposures."""
        counts = np.bincount(self.exposure, minlength=self.n_exposures)
        return np.concatenate(([0], np.cumsum(counts)))

    @property
    def columns(self) -> tuple[Floats, Floats, Floats, Floats]:
        """row_px, col_px, s_i and sd_px as the kernels take them: of one layout, and writable."""
        row_px, col_px, s_i, sd_px = (
            np.require(values, np.float64, ["C", "W"])
            for values in (self.row_px, self.col_px, self.s_i, self.sd_px)
        )
        return row_px, col_px, s_i, sd_px

    def keep(self, mask: NDArray[np.bool_], minimum: int) -> StarSelection:
        """Return the kept stars of the exposures that still have ``minimum`` of them."""
        mask, number, count = _with_enough(self.exposure, self.n_exposures, mask, minimum)
        if mask.all():
            return self
        return StarSelection(
            self.star[mask],
            number[self.exposure[mask]],
            self.row_px[mask],
            self.col_px[mask],
            self.s_i[mask],
            self.sd_px[mask],
            count,
        )

    def none(self) -> StarSelection:
        """Return a selection without any."""
        return self.keep(np.zeros(len(self.star), dtype=bool), 1)


def _with_enough(
    exposure: Ints, n_exposures: int, mask: NDArray[np.bool_], minimum: int
) -> tuple[NDArray[np.bool_], Ints, int]:
    """Return the mask without exposures of too few stars, the exposures' new numbers, how many."""
    count = np.bincount(exposure[mask], minlength=n_exposures)
    used = (count > 0) & (count >= minimum)
    return mask & used[exposure], np.cumsum(used) - 1, int(used.sum())


def centroid_sd(noise: Noise, intensity: Floats) -> Floats:
    """Return the centroid sd (S,) in pixels per axis of a noise model.

    Under ``intensity``, a star of unknown intensity counts as one of the reference intensity, and
    one of a hundredth of it or less (background subtraction gives negative counts too) as that.
    """
    if noise.model == "constant":
        return np.full(len(intensity), noise.sd_px)
    relative = np.where(np.isnan(intensity), 1.0, intensity / noise.reference_intensity)
    photon = noise.photon_sd_px**2 / np.maximum(relative, 0.01)
    return np.asarray(np.sqrt(noise.sd_px**2 + photon))


def select_stars(matched: MatchedFrames, noise: Noise, minimum: int) -> StarSelection:
    """Take the matched stars of the exposures with at least ``minimum`` (Enright: N_min = 4)."""
    frames = matched.frames
    mask = matched.is_matched & matched.solved[frames.exposure_of_star]
    # Before anything is copied: most of the time here goes into copies.
    mask, number, count = _with_enough(frames.exposure_of_star, frames.n_exposures, mask, minimum)
    star = np.flatnonzero(mask)
    return StarSelection(
        star=star,
        exposure=number[frames.exposure_of_star[star]],
        row_px=frames.row_px[star],
        col_px=frames.col_px[star],
        s_i=matched.s_i[star],
        sd_px=centroid_sd(noise, frames.intensity[star]),
        n_exposures=count,
    )


def star_departures(selection: StarSelection, camera: Camera) -> Floats:
    """Return each star's departure (K,) from its exposure's attitude, in units of its noise.

    Studentised: the attitude follows each of its stars a little, a far one among four a good deal,
    so that E|r|^2 = 2 sd^2 - tr(P (1 - s s^T)) with P the attitude's covariance.
    """
    return _judged(selection, camera, np.inf, 0)[1]


def inliers(
    selection: StarSelection, camera: Camera, sigma: float, scale: float, minimum: int
) -> NDArray[np.bool_]:
    """Return which stars (K,) are left when those beyond ``sigma`` times ``scale`` go.

    The worst of each exposure at a time, because a gross centroid bends the attitude that judges
    its neighbours; exposures with fewer than ``minimum`` left go whole.
    """
    kept, _ = _judged(selection, camera, sigma * scale, minimum)
    return _with_enough(selection.exposure, selection.n_exposures, kept, minimum)[0]


def reject_outliers(
    selection: StarSelection, camera: Camera, sigma: float, scale: float, minimum: int
) -> StarSelection:
    """Return the selection without its outliers (:func:`inliers`)."""
    return selection.keep(inliers(selection, camera, sigma, scale, minimum), minimum)


def _judged(
    selection: StarSelection, camera: Camera, limit: float, minimum: int
) -> tuple[NDArray[np.bool_], Floats]:
    """Return which stars (K,) lie within ``limit``, and the departures (K,) that tell."""
    from stcal.cameras.kernels import CAMERA_KERNELS
    from stcal.residuals.outlier_kernels import judge_stars

    kept, departure = np.ones(len(selection.star), dtype=bool), np.empty(len(selection.star))
    judge_stars(
        CAMERA_KERNELS[camera.model.name], camera.parameters, camera.pixel_size_m,
        selection.offsets, *selection.columns, limit, minimum, kept, departure,
    )  # fmt: skip
    return kept, departure
