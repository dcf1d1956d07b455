"""Estimates of the misalignment from the frames that agree, and how well they agree."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stcal.attitude import MeanRotation, mean_rotation, solve_wahba
from stcal.estimators.misalignment import (
    MISALIGNMENT,
    FrameInnovations,
    Misalignment,
    Sightings,
    frame_innovations,
    multiplicative,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_REJECTION_ROUNDS = 10
# Median of chi-square with three degrees of freedom.
_CHI2_MEDIAN = 2.366
_HISTORY_LENGTH = 100


@dataclass(frozen=True)
class AlignEstimate:
    """Estimates by every method.

    Attributes
    ----------
    kept : (F,) the frames that agree, of those that were paired
    stops : (C,) numbers of kept frames after which the estimates stand, the last is all
    methods : by name; the covariances are the methods' own, inflated
    innovations : of the kept frames
    sightings : of the kept frames
    scale : (3,) about the axes of S, scatter of the frames over their noise
    correlation : (3,) by how much correlated neighbours raise the sd of a mean
    """

    kept: Bools
    stops: Ints
    methods: dict[str, Misalignment]
    innovations: FrameInnovations
    sightings: Sightings
    scale: Floats
    correlation: Floats

    @property
    def star_scale(self) -> float:
        """Scatter of the stars about their own frame's rotation, over their noise."""
        found = self.innovations
        return float(np.sqrt(found.star_chi2.sum() / found.freedom.sum()))


def estimate_alignment(sightings: Sightings, rejection_sigma: float) -> AlignEstimate:
    """Run every method on the frames that agree.

    The covariances are raised, axis by axis, by the scatter of the frames where that is above
    their noise (never lowered: a slow error of the body's attitude scatters little), and for the
    correlation of neighbours.
    """
    kept, mean = agreeing_frames(sightings, rejection_sigma)
    used = sightings.take(kept)
    stops = np.unique(np.geomspace(2, used.n_frames, _HISTORY_LENGTH).round().astype(np.int64))
    methods = {name: method(used, stops) for name, method in MISALIGNMENT.items()}
    found = frame_innovations(used, methods["multiplicative"].c_sb[-1])
    standardised = found.rotation / np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    scale = np.sqrt((standardised**2).sum(axis=0) / (used.n_frames - 1))
    correlation = mean.sd_of_mean * np.sqrt(mean.kept.sum()) / np.maximum(mean.spread, 1e-300)
    inflation = np.maximum(scale, 1.0) * np.maximum(correlation, 1.0)
    inflated = {
        name: replace(m, covariance=m.covariance * np.outer(inflation, inflation))
        for name, m in methods.items()
    }
    return AlignEstimate(kept, stops, inflated, found, used, scale, correlation)


def agreeing_frames(sightings: Sightings, rejection_sigma: float) -> tuple[Bools, MeanRotation]:
    """Return the frames (F,) within ``rejection_sigma`` of the estimate, and their mean rotation.

    A frame is judged by its NIS over the median one, so that noise that is not well known rejects
    nothing.  The start is the robust mean of the frames' own rotations.
    """
    turns = solve_wahba(
        sightings.s_s, sightings.s_b, sightings.sd**-2.0, sightings.frame, sightings.n_frames
    )
    mean = mean_rotation(turns, rejection_sigma)
    assert mean is not None  # there are frames
    kept = mean.kept
    for _ in range(_REJECTION_ROUNDS):
        all_kept = np.array([kept.sum()])
        c_sb = multiplicative(sightings.take(kept), all_kept).c_sb[0]
        nis = frame_innovations(sightings, c_sb).nis
        now = nis <= rejection_sigma**2 * np.median(nis) / _CHI2_MEDIAN
        if np.array_equal(now, kept):
            break
        kept = now
    return kept, mean
