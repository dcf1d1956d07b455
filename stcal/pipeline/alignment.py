"""The C_SD update: no realignment after a recalibration, Enright 2018 section II-C, last paragraph.

The cost doesn't see a bulk rotation, so the fitted camera's D frame may turn against the old one.
With c_di the attitude of an exposure in D, k = c_di(old) c_di(new)^T takes new D to old D; folding
its mean into C_SD gives c_sd(new) = c_sd(old) mean(k), which nulls the mean attitude offset.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.attitude import MeanRotation, mean_rotation
from stcal.frames import MatchedFrames
from stcal.geometry.rotations import vector_from_matrix

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Alignment:
    """The updated alignment.

    Attributes
    ----------
    c_sd : (3, 3) the new C_SD
    offset : (3,) rad, about the axes of S: what the update takes out
    spread, sd_of_mean : (3,) rad, about the axes of S
    exposures_used, exposures_rejected : exposures solved under both calibrations
    """

    c_sd: Floats
    offset: Floats
    spread: Floats
    sd_of_mean: Floats
    exposures_used: int
    exposures_rejected: int


def update_alignment(c_sd: Floats, old_c_di: Floats, new_c_di: Floats) -> Alignment | None:
    """Return the update from attitudes (E, 3, 3) under both calibrations; None without any."""
    both = np.isfinite(old_c_di[:, 0, 0]) & np.isfinite(new_c_di[:, 0, 0])
    turns = old_c_di[both] @ np.swapaxes(new_c_di[both], 1, 2)
    mean = mean_rotation(turns)
    if mean is None:
        return None
    return Alignment(
        c_sd=orthonormal(c_sd @ mean.c),
        offset=c_sd @ vector_from_matrix(mean.c[None])[0],
        spread=_about(c_sd, mean.spread),
        sd_of_mean=_about(c_sd, mean.sd_of_mean),
        exposures_used=int(mean.kept.sum()),
        exposures_rejected=int((~mean.kept).sum()),
    )


def attitude_change(
    old: Sequence[MatchedFrames], old_c_sd: Floats, new: Sequence[MatchedFrames], new_c_sd: Floats
) -> MeanRotation | None:
    """Return the mean rotation in S between attitudes under two calibrations: what users see."""
    old_si = old_c_sd @ np.concatenate([m.c_di for m in old])
    new_si = new_c_sd @ np.concatenate([m.c_di for m in new])
    both = np.isfinite(old_si[:, 0, 0]) & np.isfinite(new_si[:, 0, 0])
    return mean_rotation(new_si[both] @ np.swapaxes(old_si[both], 1, 2))


def _about(c_sd: Floats, sd: Floats) -> Floats:
    """Return sd about the axes of S of independent components about the axes of D."""
    return np.sqrt((c_sd**2) @ (sd**2))


def orthonormal(c: Floats) -> Floats:
    """Return the nearest rotation to a matrix that rounding has bent."""
    left, _, right = np.linalg.svd(c)
    return np.asarray(left @ right)
