"""The columnar batch of telemetry frames: the unit of data of every stage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from stcal.constants import EXPOSURES_PER_FRAME

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_PER_STAR = ("row_px", "col_px", "intensity", "star_id")
_PER_FRAME = (
    "frame_id",
    "t_tai_ns",
    "best_exposure",
    "q_si",
    "rate_deg_s",
    "temperature_c",
    "eclipse",
    "intrusion",
    "pos_km",
    "vel_km_s",
)


class Fragment(Protocol):
    """Consecutive frames of one sensor, in memory or still in a store."""

    @property
    def sensor_id(self) -> str:
        """The sensor's name."""

    @property
    def n_frames(self) -> int:
        """Number of frames F."""

    @property
    def span_tai_ns(self) -> tuple[int, int]:
        """Times of the first and the last frame."""

    def read(self) -> FrameBatch:
        """Return the frames."""


@dataclass(frozen=True)
class FrameBatch:
    """Telemetry frames of one sensor, as columns.

    Every frame has exactly two exposures; exposure ``e`` of the batch is exposure ``e % 2`` of
    frame ``e // 2``, and its stars are ``star_offsets[e]:star_offsets[e + 1]``.  An exposure
    without detections is an empty range.

    Attributes
    ----------
    sensor_id : the sensor's name, e.g. ``ST16-1``
    frame_id : (F,) int64
    t_tai_ns : (F,) int64, mid-exposure of exposure 0
    best_exposure : (F,) int8, the exposure that the quaternion belongs to, -1 when empty
    q_si : (F, 4) telemetered attitude of S relative to I, scalar last; NaN without a fix
    rate_deg_s : (F, 3) body rates in S, NaN when empty
    temperature_c : (F,) NaN when empty
    eclipse, intrusion : (F,) bool; such frames are kept but do not count for availability
    pos_km, vel_km_s : (F, 3) geocentric ICRF state of the spacecraft, NaN when empty
    star_offsets : (2 F + 1,) int64
    row_px, col_px : (S,) centroids, the centre of the first pixel being (0, 0)
    intensity : (S,) background-subtracted counts, NaN when empty
    star_id : (S,) int64 code of the on-board match (``stcal.catalog.identifiers``), 0 = unmatched
    """

    sensor_id: str
    frame_id: Ints
    t_tai_ns: Ints
    best_exposure: NDArray[np.int8]
    q_si: Floats
    rate_deg_s: Floats
    temperature_c: Floats
    eclipse: Bools
    intrusion: Bools
    pos_km: Floats
    vel_km_s: Floats
    star_offsets: Ints
    row_px: Floats
    col_px: Floats
    intensity: Floats
    star_id: Ints

    @property
    def n_frames(self) -> int:
        """Number of frames F."""
        return len(self.frame_id)

    @property
    def span_tai_ns(self) -> tuple[int, int]:
        """Times of the first and the last frame."""
        return int(self.t_tai_ns.min()), int(self.t_tai_ns.max())

    def read(self) -> FrameBatch:
        """Return itself: frames in memory are a fragment too."""
        return self

    @property
    def n_exposures(self) -> int:
        """Number of exposures E = 2 F."""
        return EXPOSURES_PER_FRAME * self.n_frames

    @property
    def n_stars(self) -> int:
        """Number of detections S."""
        return len(self.row_px)

    @cached_property
    def stars_per_exposure(self) -> Ints:
        """(E,) number of detections in each exposure."""
        return np.diff(self.star_offsets)

    @cached_property
    def exposure_of_star(self) -> Ints:
        """(S,) index of the exposure that each detection belongs to."""
        return np.repeat(np.arange(self.n_exposures), self.stars_per_exposure)

    @cached_property
    def has_fix(self) -> Bools:
        """(F,) whether the telemetry carries a quaternion."""
        return np.asarray(np.isfinite(self.q_si).all(axis=1))

    @property
    def without_velocity(self) -> int:
        """Number of frames in which the spacecraft's velocity is unknown."""
        return int((~np.isfinite(self.vel_km_s).all(axis=1)).sum())

    @cached_property
    def counts_for_availability(self) -> Bools:
        """(F,) frames outside eclipse and intrusion."""
        return ~(self.eclipse | self.intrusion)

    def take(self, frames: NDArray[np.bool_] | Ints) -> FrameBatch:
        """Return the selected frames (mask, or indices in the wanted order) with their stars."""
        index, exposures = _with_exposures(frames)
        stars, offsets = take_ranges(self.star_offsets, exposures)
        columns = {name: getattr(self, name)[index] for name in _PER_FRAME}
        columns |= {name: getattr(self, name)[stars] for name in _PER_STAR}
        return replace(self, star_offsets=offsets, **columns)


def _with_exposures(frames: NDArray[np.bool_] | Ints) -> tuple[Ints, Ints]:
    """Return the indices of selected frames, and those of their exposures."""
    index: Ints = np.flatnonzero(frames) if frames.dtype == np.bool_ else np.asarray(frames, int)
    return index, exposures_of(index)


def exposures_of(frames: Ints) -> Ints:
    """Return the indices (2 K,) of the exposures of frames (K,)."""
    both = EXPOSURES_PER_FRAME * frames[:, None] + np.arange(EXPOSURES_PER_FRAME)
    return np.asarray(both.ravel())


def take_ranges(offsets: Ints, which: Ints) -> tuple[Ints, Ints]:
    """Return the flat indices of the ranges ``which``, and the offsets of the result."""
    counts = np.diff(offsets)[which]
    taken = np.concatenate(([0], np.cumsum(counts)))
    flat = np.repeat(offsets[which] - taken[:-1], counts) + np.arange(taken[-1])
    return flat, taken


def concatenate(batches: Sequence[FrameBatch]) -> FrameBatch:
    """Join batches of one sensor, in the order given."""
    if not batches:
        raise ValueError("nothing to concatenate")
    columns = {
        f.name: np.concatenate([getattr(b, f.name) for b in batches])
        for f in fields(FrameBatch)
        if f.name not in ("sensor_id", "star_offsets")
    }
    counts = np.concatenate([b.stars_per_exposure for b in batches])
    offsets = np.concatenate(([0], np.cumsum(counts)))
    return FrameBatch(sensor_id=batches[0].sensor_id, star_offsets=offsets, **columns)


@dataclass(frozen=True)
class MatchedFrames:
    """Frames with the stars that one calibration identifies in them.

    Attributes
    ----------
    frames : the batch
    star : (S,) int32 index into the catalogue used, -1 = unmatched
    s_i : (S, 3) apparent direction of the matched star in I, NaN where unmatched
    solved : (E,) bool, whether the exposure was identified
    reason : (E,) int8, index into ``stcal.matching.REASONS``: why an exposure was not
    c_di : (E, 3, 3) attitude of D relative to I, NaN where unsolved
    residual : (S,) rad, departure of the star from its exposure's attitude, NaN where unmatched
    """

    frames: FrameBatch
    star: NDArray[np.int32]
    s_i: Floats
    solved: Bools
    reason: NDArray[np.int8]
    c_di: Floats
    residual: Floats

    def take(self, frames: NDArray[np.bool_] | Ints) -> MatchedFrames:
        """Return the selected frames (mask, or indices in the wanted order) with their matches."""
        index, exposures = _with_exposures(frames)
        stars, _ = take_ranges(self.frames.star_offsets, exposures)
        return MatchedFrames(
            self.frames.take(index),
            self.star[stars],
            self.s_i[stars],
            self.solved[exposures],
            self.reason[exposures],
            self.c_di[exposures],
            self.residual[stars],
        )

    @cached_property
    def is_matched(self) -> Bools:
        """(S,) whether the detection is matched."""
        return self.star >= 0

    @cached_property
    def matches_per_exposure(self) -> Ints:
        """(E,) number of matched stars."""
        return np.bincount(
            self.frames.exposure_of_star[self.is_matched], minlength=self.frames.n_exposures
        )

    @cached_property
    def matches_per_frame(self) -> Ints:
        """(F,) number of matched stars in both exposures together."""
        return np.asarray(self.matches_per_exposure.reshape(-1, EXPOSURES_PER_FRAME).sum(axis=1))

    @cached_property
    def frame_solved(self) -> Bools:
        """(F,) whether any exposure of the frame was identified."""
        return np.asarray(self.solved.reshape(-1, EXPOSURES_PER_FRAME).any(axis=1))
