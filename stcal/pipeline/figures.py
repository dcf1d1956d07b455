"""The last pass of a fit: what the fitted camera changes, summed over the stars that were used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.attitude import solve_wahba
from stcal.calibration import Calibration
from stcal.cameras import Camera
from stcal.frames import exposures_of
from stcal.metrics import occupied_cells
from stcal.pipeline.alignment import frame_turns
from stcal.pipeline.fitting import Fitting
from stcal.pipeline.pieces import Piece
from stcal.pipeline.sums import Sums
from stcal.pipeline.views import ViewSums, view_sums
from stcal.residuals import StarSelection, choose_arcs

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class ArcSums(Sums):
    """Sums of squared arclength errors [rad^2] under one or more cameras, over the same arcs."""

    squares: Floats
    arcs: int

    @property
    def rms_rad(self) -> Floats:
        """Plain root mean square under each camera, NaN without arcs."""
        with np.errstate(invalid="ignore"):
            return np.asarray(np.sqrt(self.squares / self.arcs)) if self.arcs else self.squares / 0


def arc_sums(stars: StarSelection, cameras: Sequence[Camera]) -> ArcSums:
    """Sum the arclength errors of stars."""
    arcs = choose_arcs(stars)
    squares = [float((arcs.departures(camera) ** 2).sum()) for camera in cameras]
    return ArcSums(np.array(squares), len(arcs))


@dataclass(frozen=True)
class Figures:
    """What a fit's document shows of its stars.

    Attributes
    ----------
    arcs : errors under the initial and the fitted camera
    occupied : cells of the detector that hold a star (``stcal.metrics.occupied_cells``)
    turns : (K, 3, 3) rotation of S from the fitted to the initial attitude, of a sample of frames
    views : the residual field, of a sample of fragments
    """

    arcs: ArcSums
    occupied: Bools
    turns: Floats
    views: ViewSums

    def __add__(self, other: Figures) -> Figures:
        """Return the figures of both, this one's frames being the earlier."""
        return Figures(
            self.arcs + other.arcs,
            self.occupied | other.occupied,
            np.concatenate([self.turns, other.turns]),
            self.views + other.views,
        )


@dataclass(frozen=True)
class MakeFigures:
    """The pass over pieces.

    Attributes
    ----------
    baseline : the cycle that holds what the initial calibration identifies
    turn_step : every which frame gives a rotation
    viewed : numbers of the pieces whose residuals are looked at star by star
    """

    fitting: Fitting
    initial: Calibration
    camera: Camera
    baseline: str
    turn_step: int
    viewed: frozenset[int]

    def __call__(self, piece: Piece) -> Figures:
        """Sum over one piece."""
        usable = self.fitting.usable_stars(piece)
        kept = self.fitting.kept_stars(piece, usable)
        before, after = self.initial.camera, self.camera
        seen = kept if piece.number in self.viewed else kept.none()
        return Figures(
            arcs=arc_sums(kept, (before, after)),
            occupied=occupied_cells(kept.row_px, kept.col_px, after),
            turns=self._turns(piece, usable),
            views=view_sums(seen, before, after),
        )

    def _turns(self, piece: Piece, stars: StarSelection) -> Floats:
        """Compare attitudes of the last matches, solved with the fitted camera, with the first's.

        The last matches were made with the camera before; their own attitudes were its.
        """
        scratch, number = self.fitting.scratch, piece.number
        (old,) = scratch.get(f"{self.baseline} attitudes", number)
        new = np.full(old.shape, np.nan)
        (exposures,) = scratch.get(f"{self.fitting.cycle} exposures", number)
        both = exposures_of(piece.every(self.turn_step))
        shown = np.isin(exposures, both)
        new[exposures[shown]] = attitudes(stars.keep(shown[stars.exposure], 1), self.camera)
        c_sd = self.initial.c_sd
        return frame_turns(c_sd @ old[both], c_sd @ new[both])


def attitudes(stars: StarSelection, camera: Camera) -> Floats:
    """Return c_di (X, 3, 3) of usable exposures."""
    s_d = camera.directions(stars.row_px, stars.col_px)
    return solve_wahba(s_d, stars.s_i, np.ones(len(s_d)), stars.exposure, stars.n_exposures)
