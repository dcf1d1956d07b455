"""The pass that identifies the stars of a fragment and keeps what a fit needs of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.frames import FrameBatch, MatchedFrames
from stcal.matching import Matcher, match
from stcal.matching.identify import rematch_given, telemetered_matches
from stcal.pipeline.pieces import Piece, step_for
from stcal.pipeline.scratch import Scratch
from stcal.pipeline.sums import Sums
from stcal.residuals import StarSelection, select_stars
from stcal.residuals.departures import count_departures
from stcal.residuals.selection import star_departures

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_SERIES_LENGTH = 1500


@dataclass(frozen=True)
class Series:
    """An even sample of frames over time: when, matched stars (both exposures), and a fix."""

    t_tai_ns: Ints
    matched: Ints
    fixed: NDArray[np.bool_]

    def __add__(self, other: Series) -> Series:
        """Return this sample and the later one."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Series(*(np.concatenate(pair) for pair in pairs))


@dataclass(frozen=True)
class Identified(Sums):
    """What one calibration identifies in frames, in numbers that add up.

    Attributes
    ----------
    frames, without_velocity : frames, and those in which the spacecraft's velocity is unknown
    frames_solved, exposures_solved, matched_stars : what was identified
    changed : stars whose match is another than in the cycle before
    departures : counts of ``stcal.residuals.departures`` of the usable stars
    series : a sample for figures
    """

    frames: int
    without_velocity: int
    frames_solved: int
    exposures_solved: int
    matched_stars: int
    changed: int
    departures: Ints
    series: Series


@dataclass(frozen=True)
class Identify:
    """Identify the stars of pieces, and keep them under the name of a cycle.

    Attributes
    ----------
    cycle : what the kept arrays belong to
    method : a matching method, or ``telemetry`` for the on-board matches
    before : the cycle whose matches are hints, and are compared with
    step : every which frame goes into the series
    """

    scratch: Scratch
    matcher: Matcher
    camera: Camera
    c_sd: Floats
    cycle: str
    method: str
    before: str | None
    step: int

    def __call__(self, piece: Piece) -> Identified:
        """Identify one piece's stars."""
        frames = piece.read()
        earlier = None
        if self.before is not None:
            (earlier,) = self.scratch.get(f"{self.before} matches", piece.number)
        matched = self._match(frames, earlier)
        return self.keep(piece, matched, earlier)

    def _match(self, frames: FrameBatch, earlier: NDArray[np.int32] | None) -> MatchedFrames:
        camera, catalogue = self.camera, self.matcher.catalogue
        if self.method == "telemetry":
            known = telemetered_matches(frames, camera, self.matcher)
            return rematch_given(frames, camera, catalogue, known)
        hints = None
        if self.method == "guided" and earlier is not None:
            # The new camera's D frame may be turned against the old: solve the old matches in it.
            hints = rematch_given(frames, camera, catalogue, earlier).c_di
        return match(frames, camera, self.c_sd, self.matcher, self.method, hints)

    def keep(
        self, piece: Piece, matched: MatchedFrames, earlier: NDArray[np.int32] | None = None
    ) -> Identified:
        """Keep a piece's matches for later passes, and count them."""
        config, frames = self.matcher.config, matched.frames
        stars = select_stars(matched, config.noise, config.fit.minimum_stars_per_exposure)
        self.scratch.put(f"{self.cycle} matches", piece.number, matched.star)
        put_stars(self.scratch, f"{self.cycle} stars", piece.number, stars)
        if self.before is None:
            self.scratch.put(f"{self.cycle} attitudes", piece.number, matched.c_di)
        exposures = frames.exposure_of_star[stars.star[stars.offsets[:-1]]]
        self.scratch.put(f"{self.cycle} exposures", piece.number, exposures)
        shown = piece.every(self.step)
        changed = matched.is_matched if earlier is None else matched.star != earlier
        return Identified(
            frames=frames.n_frames,
            without_velocity=frames.without_velocity,
            frames_solved=int(matched.frame_solved.sum()),
            exposures_solved=int(matched.solved.sum()),
            matched_stars=int(matched.is_matched.sum()),
            changed=int(changed.sum()),
            departures=count_departures(star_departures(stars, self.camera)),
            series=series_of(matched, shown),
        )


def series_of(matched: MatchedFrames, shown: Ints) -> Series:
    """Return the series of the frames ``shown``."""
    times, stars, fixed = matched.frames.t_tai_ns, matched.matches_per_frame, matched.frame_solved
    return Series(times[shown], stars[shown], fixed[shown])


def series_step(pieces: Sequence[Piece]) -> int:
    """Return every which frame a series shows."""
    return step_for(pieces, _SERIES_LENGTH)


def put_stars(scratch: Scratch, name: str, number: int, stars: StarSelection) -> None:
    """Keep a selection of stars, in few bytes: they pass through files."""
    scratch.put(
        name, number, stars.star.astype(np.int32), np.diff(stars.offsets).astype(np.int32),
        stars.row_px, stars.col_px, stars.s_i, stars.sd_px,
    )  # fmt: skip


def get_stars(scratch: Scratch, name: str, number: int) -> StarSelection:
    """Return a kept selection of stars."""
    star, counts, row_px, col_px, s_i, sd_px = scratch.get(name, number)
    exposure = np.repeat(np.arange(len(counts)), counts)
    return StarSelection(
        star.astype(np.int64), exposure, row_px, col_px, s_i, sd_px, n_exposures=len(counts)
    )
