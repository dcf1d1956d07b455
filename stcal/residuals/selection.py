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

# Median of the Rayleigh distribution with unit sd per axis.
_RAYLEIGH_MEDIAN = float(np.sqrt(2.0 * np.log(2.0)))


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

    def keep(self, mask: NDArray[np.bool_], minimum: int) -> StarSelection:
        """Return the kept stars of the exposures that still have ``minimum`` of them."""
        count = np.bincount(self.exposure[mask], minlength=self.n_exposures)
        used = (count > 0) & (count >= minimum)
        mask = mask & used[self.exposure]
        number = np.cumsum(used) - 1
        return StarSelection(
            self.star[mask],
            number[self.exposure[mask]],
            self.row_px[mask],
            self.col_px[mask],
            self.s_i[mask],
            self.sd_px[mask],
            int(used.sum()),
        )


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
    star = np.flatnonzero(matched.is_matched & matched.solved[frames.exposure_of_star])
    everything = StarSelection(
        star=star,
        exposure=frames.exposure_of_star[star],
        row_px=frames.row_px[star],
        col_px=frames.col_px[star],
        s_i=matched.s_i[star],
        sd_px=centroid_sd(noise, frames.intensity[star]),
        n_exposures=frames.n_exposures,
    )
    return everything.keep(np.ones(len(star), dtype=bool), minimum)


def star_departures(selection: StarSelection, camera: Camera) -> Floats:
    """Return each star's departure (K,) from its exposure's attitude, in units of its noise.

    Studentised: the attitude follows each of its stars a little, a far one among four a good deal,
    so that E|r|^2 = 2 sd^2 - tr(P (1 - s s^T)) with P the attitude's covariance.
    """
    return _judged(selection, camera, np.inf, 0)[1]


def robust_scale(departures: Floats) -> float:
    """Return the sd per axis of departures, from their median."""
    return float(np.median(departures)) / _RAYLEIGH_MEDIAN if len(departures) else 1.0


def reject_outliers(
    selection: StarSelection, camera: Camera, sigma: float, scale: float, minimum: int
) -> StarSelection:
    """Leave out stars beyond ``sigma`` times ``scale``, the worst of each exposure at a time.

    One at a time, because a gross centroid bends the attitude that judges its neighbours.
    """
    kept, _ = _judged(selection, camera, sigma * scale, minimum)
    return selection if kept.all() else selection.keep(kept, minimum)


def _judged(
    selection: StarSelection, camera: Camera, limit: float, minimum: int
) -> tuple[NDArray[np.bool_], Floats]:
    """Return which stars (K,) lie within ``limit``, and the departures (K,) that tell."""
    from stcal.cameras.kernels import CAMERA_KERNELS
    from stcal.residuals.outlier_kernels import judge_stars

    kept, departure = np.ones(len(selection.star), dtype=bool), np.empty(len(selection.star))
    judge_stars(
        CAMERA_KERNELS[camera.model.name], camera.parameters, camera.pixel_size_m,
        selection.offsets, selection.row_px, selection.col_px,
        np.ascontiguousarray(selection.s_i), selection.sd_px, limit, minimum, kept, departure,
    )  # fmt: skip
    return kept, departure
