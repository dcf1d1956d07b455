"""Attitude: batched Wahba solution with covariance, the frame's quaternion, robust averages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stcal.constants import EXPOSURES_PER_FRAME
from stcal.geometry.rotations import vector_from_matrix

if TYPE_CHECKING:
    from stcal.frames import MatchedFrames

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]


def solve_wahba(
    s_d: Floats, s_i: Floats, weight: Floats, exposure: Ints, n_exposures: int
) -> Floats:
    """Return c_di (E, 3, 3) minimising sum w |s_d - c_di s_i|^2 for each exposure.

    Parameters are columns over stars: s_d, s_i (S, 3), weight (S,), exposure (S,).  What the SVD
    of the attitude profile matrix gives (Markley 1988).  NaN for exposures with under two stars.
    """
    from stcal.attitude_kernels import solve_attitudes

    c_di = np.empty((n_exposures, 3, 3))
    solve_attitudes(_column(s_d), _column(s_i), _column(weight), _numbers(exposure), c_di)
    return c_di


def attitude_covariance(s_d: Floats, sd: Floats, exposure: Ints, n_exposures: int) -> Floats:
    """Return the covariance (E, 3, 3) [rad^2] of the small rotation error, in D.

    For the solution with weights 1 / sd^2: P = (sum (1 - s s^T) / sd^2)^-1 (Shuster & Oh 1981);
    NaN where stars don't fix the attitude.
    """
    return _inverse(_information(s_d, (sd * sd) ** -1.0, exposure, n_exposures))


def unweighted_covariance(s_d: Floats, sd: Floats, exposure: Ints, n_exposures: int) -> Floats:
    """Return the same for the solution with equal weights: P = A^-1 [sum sd^2 (1 - s s^T)] A^-1.

    A = sum (1 - s s^T).  This is the solution that identification gives.
    """
    inverse = _inverse(_information(s_d, np.ones(len(sd)), exposure, n_exposures))
    middle = _information(s_d, sd * sd, exposure, n_exposures)
    return np.asarray(inverse @ middle @ inverse)


def _information(s_d: Floats, weight: Floats, exposure: Ints, n_exposures: int) -> Floats:
    """Sum w (1 - s s^T) by exposure."""
    from stcal.attitude_kernels import sum_information

    total = np.empty((n_exposures, 3, 3))
    sum_information(_column(s_d), _column(weight), _numbers(exposure), total)
    return total


def _inverse(total: Floats) -> Floats:
    from stcal.attitude_kernels import invert_each

    covariance = np.empty_like(total)
    invert_each(total, covariance)
    return covariance


def _column(values: Floats) -> Floats:
    """Return an array as the kernels take them, of one layout."""
    return np.require(values, np.float64, ["C", "W"])


def _numbers(values: Ints) -> Ints:
    return np.require(values, np.int64, ["C", "W"])


def residual_angles(s_d: Floats, s_i: Floats, c_di: Floats) -> Floats:
    """Return |s_d - c_di s_i| (S,) rad; c_di is given per star (S, 3, 3)."""
    difference = s_d - np.einsum("sij,sj->si", c_di, s_i)
    return np.asarray(np.sqrt(np.einsum("si,si->s", difference, difference)))


def better_exposure(matched: MatchedFrames) -> NDArray[np.int8]:
    """(F,) the exposure with the higher-quality solution, -1 without any.

    More matched stars first, then the smaller RMS residual, as the sensor reports the image with
    the better solution (Enright 2018, section I-B).
    """
    frames = matched.frames
    residual2 = np.where(matched.is_matched, matched.residual**2, 0.0)
    total = np.bincount(frames.exposure_of_star, residual2, minlength=frames.n_exposures)
    count = np.where(matched.solved, matched.matches_per_exposure, 0)
    mean = total / np.maximum(count, 1)
    count, mean = (a.reshape(-1, EXPOSURES_PER_FRAME) for a in (count, mean))
    second = (count[:, 1] > count[:, 0]) | (
        (count[:, 1] == count[:, 0]) & (mean[:, 1] < mean[:, 0])
    )
    return np.where(count.max(axis=1) > 0, second.astype(np.int8), np.int8(-1)).astype(np.int8)


def frame_attitudes(matched: MatchedFrames) -> tuple[Floats, NDArray[np.int8]]:
    """Return c_di (F, 3, 3) of each frame's better exposure (NaN without) and which (F,)."""
    best = better_exposure(matched)
    exposure = EXPOSURES_PER_FRAME * np.arange(len(best)) + np.maximum(best, 0)
    c_di = matched.c_di[exposure]
    c_di[best < 0] = np.nan
    return c_di, best


def frame_quaternions(matched: MatchedFrames, c_sd: Floats) -> tuple[Floats, NDArray[np.int8]]:
    """Return q_si (F, 4), scalar last with positive scalar, NaN without a fix, and the exposure."""
    from scipy.spatial.transform import Rotation

    c_di, best = frame_attitudes(matched)
    q_si = np.full((len(best), 4), np.nan)
    good = best >= 0
    if good.any():
        # A(q) = c_si and Rotation.from_quat(q) applied to v_S gives v_I: the transpose.
        c_is = np.swapaxes(c_sd @ c_di[good], 1, 2)
        q_si[good] = Rotation.from_matrix(c_is).as_quat(canonical=True)
    return q_si, best


def attitudes_from_quaternions(q_si: Floats, c_sd: Floats) -> Floats:
    """Return c_di (F, 3, 3) of telemetered quaternions (F, 4); NaN where there is none."""
    from scipy.spatial.transform import Rotation

    c_di = np.full((len(q_si), 3, 3), np.nan)
    good = np.isfinite(q_si).all(axis=1)
    if good.any():
        c_is = Rotation.from_quat(q_si[good]).as_matrix()
        c_di[good] = c_sd.T @ np.swapaxes(c_is, 1, 2)
    return c_di


# Median of |x| for a normal x with unit sd.
_NORMAL_MEDIAN = 0.6745


@dataclass(frozen=True)
class MeanRotation:
    """A robust mean rotation.

    Attributes
    ----------
    c : (3, 3) the mean
    spread : (3,) rad, sd of the kept rotations about the mean, per axis
    sd_of_mean : (3,) rad
    kept : (K,) bool, the rotations that were not rejected
    """

    c: Floats
    spread: Floats
    sd_of_mean: Floats
    kept: Bools


def mean_rotation(rotations: Floats, rejection_sigma: float = 5.0) -> MeanRotation | None:
    """Average rotations (K, 3, 3), in time order, by Markley et al. 2007, leaving wrong ones out.

    The start is the rotation with the least median angle to the others, which stays right while
    over half are right; then rotations beyond ``rejection_sigma`` robust sd, each axis having its
    own, are left out until the set settles.  The sd of the mean allows for the correlation of
    neighbours.  None for an empty list.
    """
    from scipy.spatial.transform import Rotation

    if len(rotations) == 0:
        return None
    mean = rotations[_most_central(rotations)]
    kept = np.ones(len(rotations), dtype=bool)
    for _ in range(20):
        vectors = vector_from_matrix(rotations @ mean.T)
        # Roll spreads about ten times as far as the cross axes.
        scale = np.maximum(np.median(np.abs(vectors), axis=0) / _NORMAL_MEDIAN, 1e-9)
        now = np.sqrt(((vectors / scale) ** 2).sum(axis=1)) <= rejection_sigma
        if not now.any():
            now = kept
        mean = Rotation.from_matrix(rotations[now]).mean().as_matrix()
        if np.array_equal(now, kept):
            break
        kept = now
    vectors = vector_from_matrix(rotations[kept] @ mean.T)
    count = int(kept.sum())
    spread = np.sqrt((vectors**2).sum(axis=0) / max(count - 1, 1))
    return MeanRotation(mean, spread, spread / np.sqrt(count / _neighbour_factor(vectors)), kept)


def _neighbour_factor(vectors: Floats) -> Floats:
    """Return (3,) by how much correlation of neighbours raises the variance of a mean."""
    total = (vectors**2).sum(axis=0)
    lag = (vectors[1:] * vectors[:-1]).sum(axis=0) / np.maximum(total, 1e-300)
    lag = np.clip(lag, 0.0, 0.95)
    return np.asarray((1.0 + lag) / (1.0 - lag))


def _most_central(rotations: Floats, sample: int = 200) -> int:
    """Index of the rotation with the least median angle to the others (of an even sample)."""
    index = np.unique(np.linspace(0, len(rotations) - 1, min(sample, len(rotations))).astype(int))
    flat = rotations[index].reshape(len(index), 9)
    trace = flat @ flat.T
    return int(index[np.argmax(np.median(trace, axis=1))])
