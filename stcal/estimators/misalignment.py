"""Misalignment of a sensor in the spacecraft's body: the second stage of Zhang et al. 2024.

With the body's attitude c_bi from elsewhere, every identified star gives a pair of unit vectors,
s_s measured in S and s_b = c_bi s_i in B, related by s_s = c_sb s_b + n (eqs 40-43; their
A_body^sensor is c_sb, their w and v are s_s and s_b).

A measured unit vector has no noise along itself: n has the covariance sd^2 (1 - s_s s_s^T).  An
error of the body's attitude turns all stars of a frame together.  Both are in the covariances
here, which are those of the small rotation error e about the axes of S, c_sb = exp(e x) c_sb(true).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.geometry.rotations import matrix_from_vector, nearest_rotation

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_ITERATIONS = 20
_STEP_RAD = 1e-13
# (a x b)_i = _CROSS_ijk a_j b_k
_CROSS = np.zeros((3, 3, 3))
_CROSS[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
_CROSS[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = -1.0


@dataclass(frozen=True)
class Sightings:
    """Star vectors in both frames, frame by frame.

    Attributes
    ----------
    s_s, s_b : (K, 3) unit star vectors: measured, in S; from catalogue and body attitude, in B
    sd : (K,) rad, noise of s_s per axis of the tangent plane
    frame : (K,) telemetry frame of each star, rising, every one of 0..F-1 with two stars or more
    attitude_covariance : (F, 3, 3) rad^2, of the body attitude's small rotation error in B
    """

    s_s: Floats
    s_b: Floats
    sd: Floats
    frame: Ints
    attitude_covariance: Floats

    @property
    def n_frames(self) -> int:
        """Number of telemetry frames F."""
        return len(self.attitude_covariance)

    def take(self, frames: NDArray[np.bool_]) -> Sightings:
        """Return the frames of a mask (F,), numbered anew."""
        star = frames[self.frame]
        number = np.cumsum(frames) - 1
        return Sightings(
            self.s_s[star],
            self.s_b[star],
            self.sd[star],
            number[self.frame[star]],
            self.attitude_covariance[frames],
        )


@dataclass(frozen=True)
class Misalignment:
    """Estimates after each of C numbers of frames.

    Attributes
    ----------
    c_sb : (C, 3, 3) rotation from B to S
    covariance : (C, 3, 3) rad^2, of the small rotation error about the axes of S
    """

    c_sb: Floats
    covariance: Floats


def linear(sightings: Sightings, stops: Ints) -> Misalignment:
    """Linear filter on the nine elements (eqs 44-51), projected onto the rotations.

    The filter has no process noise, so it is summed up: with the measurement covariance sd^2 1 of
    eq (49) and nothing known before, the rows of the matrix decouple and P = 1 x (sum s_b s_b^T /
    sd^2)^-1.  The gain is that of the paper; the covariance is not the filter's own P but what the
    true noise (see the module) does through this gain.

    Parameters
    ----------
    sightings : the star vectors
    stops : (C,) numbers of frames after which to give the estimate, rising
    """
    c_sb = nearest_rotation((sightings.s_s.T * sightings.sd**-2.0) @ sightings.s_b)
    noise_s = c_sb @ sightings.attitude_covariance @ c_sb.T
    gram, profile, middle = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((9, 9))
    found = []
    for first, stop in zip(np.append(0, stops[:-1]), stops, strict=True):
        part = _linear_sums(sightings, noise_s, slice(int(first), int(stop)))
        gram, profile, middle = gram + part[0], profile + part[1], middle + part[2]
        found.append(_projected(gram, profile, middle))
    return Misalignment(*(np.stack(column) for column in zip(*found, strict=True)))


def _linear_sums(
    sightings: Sightings, noise_s: Floats, frames: slice
) -> tuple[Floats, Floats, Floats]:
    """Return sum s_b s_b^T / sd^2, sum s_s s_b^T / sd^2, and the covariance (9, 9) of the latter.

    The last is of the elements row by row, as x in eq (45).
    """
    a, b = np.searchsorted(sightings.frame, (frames.start, frames.stop))
    s_s, s_b, weight = sightings.s_s[a:b], sightings.s_b[a:b], sightings.sd[a:b] ** -2.0
    gram = (s_b.T * weight) @ s_b
    outer = (s_s[:, :, None] * s_b[:, None, :]).reshape(-1, 9)
    by_star = np.kron(np.eye(3), gram) - (outer.T * weight) @ outer
    # The error e of a body attitude, in S, adds s_s x e to each star vector of the frame.
    count = frames.stop - frames.start
    by_frame = _sum_by_frame(outer * weight[:, None], sightings.frame[a:b] - frames.start, count)
    turned = np.einsum("ipc,fpm->fimc", _CROSS, by_frame.reshape(-1, 3, 3)).reshape(-1, 9, 3)
    common = np.einsum("fac,fcd,fbd->ab", turned, noise_s[frames], turned, optimize=True)
    return gram, by_frame.sum(axis=0).reshape(3, 3), by_star + common


def _projected(gram: Floats, profile: Floats, middle: Floats) -> tuple[Floats, Floats]:
    """Return the rotation nearest to the nine elements, and its covariance.

    To first order the projection keeps the antisymmetric part of the error: e_l = 1/2 _CROSS_lai
    (dA A^T)_ia.
    """
    p = np.linalg.pinv(gram, hermitian=True)
    c_sb = nearest_rotation(np.asarray(profile @ p))
    gain = 0.5 * np.einsum("lai,am->lim", _CROSS, c_sb @ p).reshape(3, 9)
    return c_sb, gain @ middle @ gain.T


def multiplicative(sightings: Sightings, stops: Ints) -> Misalignment:
    """Filter on a small rotation e about the axes of S: s_s = c_sb s_b + e x (c_sb s_b) + n.

    The noise has its true covariance: a frame of information M = sum (1 - s s^T) / sd^2 and body
    attitude noise R (in S) gives (M^-1 + R)^-1.  Linearised anew until the estimate stands; then
    the sums up to each stop give the earlier estimates.  Parameters as in :func:`linear`.
    """
    moments = _moments(sightings)
    c_sb = nearest_rotation(moments.profile.sum(axis=0))
    for _ in range(_ITERATIONS):
        information, vector = _frame_information(moments, sightings, c_sb)
        step = np.linalg.solve(information.sum(axis=0), vector.sum(axis=0))
        if np.linalg.norm(step) < _STEP_RAD:
            break
        c_sb = matrix_from_vector(step) @ c_sb
    covariance = np.asarray(np.linalg.inv(np.cumsum(information, axis=0)[stops - 1]), np.float64)
    steps = np.einsum("cij,cj->ci", covariance, np.cumsum(vector, axis=0)[stops - 1])
    return Misalignment(matrix_from_vector(steps) @ c_sb, covariance)


# name -> (sightings, stops) -> estimates after so many frames
MISALIGNMENT: dict[str, Callable[[Sightings, Ints], Misalignment]] = {
    "linear": linear,
    "multiplicative": multiplicative,
}


@dataclass(frozen=True)
class FrameInnovations:
    """How the frames, each by itself, depart from an estimate.

    Attributes
    ----------
    rotation : (F, 3) rad about the axes of S
    covariance : (F, 3, 3) rad^2, of star noise and body attitude together
    nis : (F,) normalised innovation squared of the rotation, 3 degrees of freedom
    star_chi2 : (F,) of the stars about their own frame's rotation
    freedom : (F,) degrees of freedom of ``star_chi2``, 2 N - 3
    """

    rotation: Floats
    covariance: Floats
    nis: Floats
    star_chi2: Floats
    freedom: Ints


def frame_innovations(sightings: Sightings, c_sb: Floats) -> FrameInnovations:
    """Return the innovations of frames under an estimate c_sb (3, 3)."""
    moments = _moments(sightings)
    stars, vector, squares = _linearised(moments, c_sb)
    rotation = np.asarray(np.linalg.solve(stars, vector[:, :, None])[:, :, 0], np.float64)
    noise = c_sb @ sightings.attitude_covariance @ c_sb.T
    covariance = np.linalg.inv(stars) + noise
    weighted = np.linalg.solve(covariance, rotation[:, :, None])[:, :, 0]
    return FrameInnovations(
        rotation=rotation,
        covariance=covariance,
        nis=(rotation * weighted).sum(axis=1),
        star_chi2=squares - (rotation * vector).sum(axis=1),
        freedom=2 * np.bincount(sightings.frame, minlength=sightings.n_frames) - 3,
    )


@dataclass(frozen=True)
class _Moments:
    """Sums over the stars of each frame (F, 3, 3): s_b s_b^T / sd^2 and s_s s_b^T / sd^2."""

    gram: Floats
    profile: Floats


def _moments(sightings: Sightings) -> _Moments:
    weighted = sightings.s_b * (sightings.sd**-2.0)[:, None]
    sums = [
        _sum_by_frame(
            (s[:, :, None] * weighted[:, None, :]).reshape(-1, 9),
            sightings.frame,
            sightings.n_frames,
        ).reshape(-1, 3, 3)
        for s in (sightings.s_b, sightings.s_s)
    ]
    return _Moments(*sums)


def _sum_by_frame(terms: Floats, frame: Ints, n_frames: int) -> Floats:
    """Sum rows (K, C) by frame (F, C)."""
    columns = [np.bincount(frame, column, minlength=n_frames) for column in terms.T]
    return np.stack(columns, axis=1).astype(np.float64)


def _linearised(moments: _Moments, c_sb: Floats) -> tuple[Floats, Floats, Floats]:
    """Return, of the stars alone, information (F, 3, 3), vector (F, 3) and chi-square (F,)."""
    predicted = c_sb @ moments.gram @ c_sb.T
    profile = moments.profile @ c_sb.T
    total = np.trace(predicted, axis1=1, axis2=2)
    information = total[:, None, None] * np.eye(3) - predicted
    # Predicted x measured, the gradient of the squares.
    vector = np.einsum("ijk,fkj->fi", _CROSS, profile)
    return information, vector, 2.0 * (total - np.trace(profile, axis1=1, axis2=2))


def _frame_information(
    moments: _Moments, sightings: Sightings, c_sb: Floats
) -> tuple[Floats, Floats]:
    """Return information (F, 3, 3) and vector (F, 3) of each frame, body attitude noise included.

    (M^-1 + R)^-1 = (1 + M R)^-1 M, which needs neither inverse.
    """
    stars, vector, _ = _linearised(moments, c_sb)
    noise = c_sb @ sightings.attitude_covariance @ c_sb.T
    both = np.concatenate([stars, vector[:, :, None]], axis=2)
    reduced = np.linalg.solve(np.eye(3) + stars @ noise, both)
    return reduced[:, :, :3], reduced[:, :, 3]
