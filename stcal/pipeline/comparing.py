"""The pass that identifies a fragment with two calibrations and sums what the metrics need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.calibration import Calibration
from stcal.constants import EXPOSURES_PER_FRAME
from stcal.execution import OrderedMap
from stcal.frames import MatchedFrames, exposures_of
from stcal.matching import Matcher, match
from stcal.metrics import Blocks, PairSums, pair_sums
from stcal.pipeline.alignment import MOST_TURNS, frame_turns
from stcal.pipeline.identifying import Series, series_of, series_step
from stcal.pipeline.pieces import Piece, step_for, thinned
from stcal.pipeline.sums import total
from stcal.pipeline.views import ViewSums, view_sums
from stcal.residuals import Arcs, StarSelection, choose_arcs, select_stars

Floats = NDArray[np.float64]

# Columns of the sums by block, in frames that count for availability.
COUNTED, FIXED, STARS, SQUARES, PAIRS = 0, (1, 2), (3, 4), ((5, 6), (7, 8)), (9, 10)
_COLUMNS = 11


@dataclass(frozen=True)
class Compared:
    """Both calibrations (baseline first) on the same frames, in sums that add up.

    Attributes
    ----------
    sums : (B, 11) by block of consecutive frames: frames, those with a fix under each calibration,
        matched stars under each; then, for the star pairs that the baseline finds, squared
        arclength errors [rad^2] under each, the same for those that the candidate finds, and the
        numbers of the pairs.  Frames in eclipse and intrusion are left out of all.
    turns : (K, 3, 3) rotation of S from the candidate's to the baseline's attitude, a sample
    views : residual fields of the stars that each finds, of a sample of fragments
    series : matched stars and fixes over time under each, a sample
    """

    sums: Floats
    turns: Floats
    views: tuple[ViewSums, ViewSums]
    series: tuple[Series, Series]

    def __add__(self, other: Compared) -> Compared:
        """Return the sums of both, this one's frames being the earlier."""
        first, second = (a + b for a, b in zip(self.views, other.views, strict=True))
        old, new = (a + b for a, b in zip(self.series, other.series, strict=True))
        return Compared(
            self.sums + other.sums,
            np.concatenate([self.turns, other.turns]),
            (first, second),
            (old, new),
        )


@dataclass(frozen=True)
class Compare:
    """The pass over pieces.

    Attributes
    ----------
    blocks : blocks of frames to sum over
    step, turn_step : every which frame goes into the series, and gives a rotation
    viewed : numbers of the pieces whose residuals are looked at star by star
    """

    calibrations: tuple[Calibration, Calibration]
    matcher: Matcher
    method: str
    blocks: Blocks
    step: int
    turn_step: int
    viewed: frozenset[int]

    def __call__(self, piece: Piece) -> Compared:
        """Sum over one piece."""
        frames = piece.read()
        old, new = (
            match(frames, c.camera, c.c_sd, self.matcher, self.method) for c in self.calibrations
        )
        noise = self.matcher.config.noise
        minimum = self.matcher.config.fit.minimum_stars_per_exposure
        stars = [select_stars(one, noise, minimum) for one in (old, new)]
        counts = frames.counts_for_availability
        shown = piece.every(self.step)
        return Compared(
            sums=self.blocks.sum(piece.first, self._columns((old, new), stars) * counts[:, None]),
            turns=self._turns(old, new, piece),
            views=self._views(stars, piece),
            series=(series_of(old, shown[counts[shown]]), series_of(new, shown[counts[shown]])),
        )

    def _columns(
        self, matched: tuple[MatchedFrames, MatchedFrames], stars: list[StarSelection]
    ) -> Floats:
        """Return (F, 11) figures of each frame; pairs are chosen by the 2 N - 3 rule."""
        out = np.empty((matched[0].frames.n_frames, _COLUMNS))
        out[:, COUNTED] = 1.0
        for k, one in enumerate(matched):
            out[:, FIXED[k]] = one.frame_solved
            out[:, STARS[k]] = one.matches_per_frame
            arcs = choose_arcs(stars[k])
            for j, calibration in enumerate(self.calibrations):
                sums = _pair_sums(arcs, one, calibration)
                out[:, SQUARES[k][j]], out[:, PAIRS[k]] = sums.squares, sums.pairs
        return out

    def _turns(self, old: MatchedFrames, new: MatchedFrames, piece: Piece) -> Floats:
        both = exposures_of(piece.every(self.turn_step))
        before, after = (calibration.c_sd for calibration in self.calibrations)
        return frame_turns(after @ new.c_di[both], before @ old.c_di[both])

    def _views(self, stars: list[StarSelection], piece: Piece) -> tuple[ViewSums, ViewSums]:
        old, new = (calibration.camera for calibration in self.calibrations)
        if piece.number not in self.viewed:
            stars = [one.none() for one in stars]
        return view_sums(stars[0], old, new), view_sums(stars[1], old, new)


def _pair_sums(arcs: Arcs, matched: MatchedFrames, calibration: Calibration) -> PairSums:
    frames = matched.frames
    frame = frames.exposure_of_star // EXPOSURES_PER_FRAME
    return pair_sums(arcs, frame, frames.n_frames, calibration.camera)


def compared_frames(
    pieces: Sequence[Piece],
    calibrations: tuple[Calibration, Calibration],
    matcher: Matcher,
    method: str,
    mapper: OrderedMap,
) -> Compared:
    """Identify all frames with both calibrations and sum, in one pass."""
    task = Compare(
        calibrations=calibrations,
        matcher=matcher,
        method=method,
        blocks=Blocks.over(sum(piece.n_frames for piece in pieces)),
        step=series_step(pieces),
        turn_step=step_for(pieces, MOST_TURNS),
        viewed=frozenset(piece.number for piece in thinned(pieces)),
    )
    return total(mapper(task, pieces))
