"""Performance metrics of a calibration: availability, matched stars, common-pair RMS, residuals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.attitude import solve_wahba
from stcal.cameras import Camera
from stcal.residuals.arclength import Arcs
from stcal.residuals.selection import StarSelection

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# What may be lost without harm, as a share: with enough frames any loss becomes significant.
MARGINS = {"availability": 0.005, "matched stars": 0.005, "common-pair RMS": 0.01}
_RESAMPLES = 2000
_LARGEST_RESAMPLE = 5000


@dataclass(frozen=True)
class PairSums:
    """Sums over the arcs of each frame, from which RMS values and their spread follow.

    Attributes
    ----------
    squares : (F,) rad^2, sum of squared arclength errors
    pairs : (F,) number of arcs
    """

    squares: Floats
    pairs: Ints

    @property
    def rms_rad(self) -> float:
        """Plain root mean square over all arcs (Enright 2018 eq 20, read as theory demands)."""
        total = int(self.pairs.sum())
        return float(np.sqrt(self.squares.sum() / total)) if total else float("nan")


def pair_sums(arcs: Arcs, frame_of_star: Ints, n_frames: int, camera: Camera) -> PairSums:
    """Sum arclength errors of one camera over given arcs, by frame.

    ``frame_of_star`` (S,) maps a detection of the batch to its frame.
    """
    frame = frame_of_star[arcs.selection.star[arcs.pair_i]]
    squares = arcs.departures(camera) ** 2
    return PairSums(
        np.bincount(frame, squares, minlength=n_frames).astype(np.float64),
        np.bincount(frame, minlength=n_frames),
    )


@dataclass(frozen=True)
class Interval:
    """A value with its bootstrap confidence interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Blocks:
    """Blocks of consecutive frames that are summed before resampling: at most one a frame.

    They bound what a long run costs and keep the correlation of neighbouring frames.

    Attributes
    ----------
    edges : (B,) number of the first frame of each block, from 0
    """

    edges: Ints

    @staticmethod
    def over(frames: int) -> Blocks:
        """Return nearly equal blocks of so many frames, each frame its own while they are few."""
        count = min(frames, _LARGEST_RESAMPLE)
        return Blocks(np.linspace(0, frames, count, endpoint=False).astype(np.int64))

    def sum(self, first: int, columns: Floats) -> Floats:
        """Return (B, C) sums of columns (F, C) of consecutive frames from ``first`` on."""
        block = np.searchsorted(self.edges, first + np.arange(len(columns)), side="right") - 1
        sums = [np.bincount(block, column, minlength=len(self.edges)) for column in columns.T]
        return np.stack(sums, axis=1)


def bootstrap(
    statistic: Callable[[Floats], Floats], columns: Floats, confidence: float, seed: int = 0
) -> Interval:
    """Percentile interval of a statistic of sums over frames (Efron 1979).

    ``columns`` (B, C) by frame, or by block of frames, are resampled; ``statistic`` maps sums
    (R, C) to values (R,).
    """
    count = len(columns)
    value = float(statistic(columns.sum(axis=0, keepdims=True))[0])
    if count == 0:
        return Interval(value, value, value)
    rng = np.random.default_rng(seed)
    weights = rng.multinomial(count, np.full(count, 1.0 / count), size=_RESAMPLES)
    values = statistic(weights @ columns)
    values = values[np.isfinite(values)]
    if len(values) == 0:
        return Interval(value, value, value)
    tail = 50.0 * (1.0 - confidence)
    low, high = np.percentile(values, [tail, 100.0 - tail])
    return Interval(value, float(low), float(high))


def ratio(sums: Floats) -> Floats:
    """Statistic: first column over second."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(sums[:, 0] / sums[:, 1])


def root_ratio(sums: Floats) -> Floats:
    """Statistic: square root of first column over second."""
    return np.sqrt(ratio(sums))


def root_loss(sums: Floats) -> Floats:
    """Statistic: one less the square root of first column over second."""
    return np.asarray(1.0 - root_ratio(sums))


def difference(sums: Floats) -> Floats:
    """Statistic: (first - second) over third column."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray((sums[:, 0] - sums[:, 1]) / sums[:, 2])


def residual_vectors(selection: StarSelection, camera: Camera) -> Floats:
    """Return measured minus predicted centroids (K, 2) [px], attitudes solved per exposure."""
    s_d = camera.directions(selection.row_px, selection.col_px)
    c_di = solve_wahba(
        s_d,
        selection.s_i,
        np.ones(len(s_d)),
        selection.exposure,
        selection.n_exposures,
    )
    predicted = np.einsum("kij,kj->ki", c_di[selection.exposure], selection.s_i)
    m, n = camera.project(predicted)
    return np.stack([selection.row_px - m, selection.col_px - n], axis=1)


def detector_cells(rows: int, cols: int, across: int = 12) -> tuple[int, int]:
    """Return the numbers of nearly square cells (down, across) of a detector."""
    size = max(rows, cols) / across
    return max(1, round(rows / size)), max(1, round(cols / size))


def cell_of(row_px: Floats, col_px: Floats, camera: Camera, cells: tuple[int, int]) -> Ints:
    """Return the cell number (K,) of centroids."""
    i = np.clip(((row_px + 0.5) / camera.rows * cells[0]).astype(int), 0, cells[0] - 1)
    j = np.clip(((col_px + 0.5) / camera.cols * cells[1]).astype(int), 0, cells[1] - 1)
    return np.asarray(i * cells[1] + j)


def occupied_cells(row_px: Floats, col_px: Floats, camera: Camera) -> NDArray[np.bool_]:
    """Return which detector cells (8 along the longer side) hold a star; their mean is coverage."""
    cells = detector_cells(camera.rows, camera.cols, across=8)
    occupied = np.zeros(cells[0] * cells[1], dtype=np.bool_)
    occupied[cell_of(row_px, col_px, camera, cells)] = True
    return occupied
