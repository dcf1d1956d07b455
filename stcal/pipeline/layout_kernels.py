"""What the compiled pass over frames works on: records of arrays, and its signature.

A file of kernels by name, because compiled code depends on the order of these fields.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import boolean, float32, float64, int8, int32, int64, types, void
from numpy.typing import NDArray

from stcal.cameras.unit_kernels import CAMERA_SIGNATURE
from stcal.estimators.pointer_kernels import COVARIANCE, PREDICT, UPDATE
from stcal.matching.kernels import Join, PairTable, Rule, Sky, Slots, StarMap, Work
from stcal.residuals.contract_kernels import BIND, ROWS

# Innovations of a frame are at most so many times its detections: three values of N - 2 groups.
ROOM = 3


class Telemetry(NamedTuple):
    """Columns of a stretch of frames; ``warmth`` (F,) is K above the reference temperature,
    ``gap`` (F,) the square root of the hours since the frame before."""

    offsets: NDArray[np.int64]
    row_px: NDArray[np.float64]
    col_px: NDArray[np.float64]
    intensity: NDArray[np.float64]
    sd_px: NDArray[np.float64]
    observers: NDArray[np.float64]
    hints: NDArray[np.float64]
    warmth: NDArray[np.float64]
    gap: NDArray[np.float64]


class Baseline(NamedTuple):
    """What the baseline calibration identifies in the same frames."""

    star: NDArray[np.int32]
    s_i: NDArray[np.float64]
    c_di: NDArray[np.float64]
    status: NDArray[np.int8]


class Model(NamedTuple):
    """How the state (n,) makes the camera: x[k] * scale[k] (times the warmth where ``thermal``)
    is added to camera parameter ``target[k]`` of ``reference`` (P,)."""

    reference: NDArray[np.float64]
    pixel_size_m: float
    rows: float
    cols: float
    target: NDArray[np.int64]
    scale: NDArray[np.float64]
    thermal: NDArray[np.bool_]
    noise_sd: NDArray[np.float64]
    slope_table: NDArray[np.float64]
    linearise_at: NDArray[np.float64]
    options: NDArray[np.float64]


class Rules(NamedTuple):
    """The variant of the filter, and when it is not to be trusted."""

    rematch: bool
    guided: bool
    unscented: bool
    fixed: bool
    shadow: bool
    minimum_stars: int
    rejection_sigma: float
    lost_frames: int
    lost_star_share: float
    divergence: float
    divergence_noise: float


class State(NamedTuple):
    """What goes from frame to frame: the estimate with its root; the one that a reset goes back to;
    the one before the frames in the window, the state at which those were linearised, and the one
    of the slopes of the noise; ``tally`` and ``window`` belong to ``watch_kernels``."""

    x: NDArray[np.float64]
    root: NDArray[np.float64]
    start_x: NDArray[np.float64]
    start_root: NDArray[np.float64]
    base_x: NDArray[np.float64]
    base_root: NDArray[np.float64]
    linearised_at: NDArray[np.float64]
    sloped_at: NDArray[np.float64]
    tally: NDArray[np.float64]
    window: NDArray[np.float64]


class Kept(NamedTuple):
    """The frames (B,) that can be linearised anew, a ring.

    ``star`` (B, M, 6): row, column, s_i, sd [px] of the matched stars; ``c_di`` (B, 2, 3, 3);
    ``facts`` (B, 4): stars of either exposure, warmth, gap; ``after`` (B, n + 1, n): x and the root
    after each frame; ``place`` (2,): the oldest frame's slot and the number of frames.
    """

    star: NDArray[np.float64]
    c_di: NDArray[np.float64]
    facts: NDArray[np.float64]
    after: NDArray[np.float64]
    place: NDArray[np.int64]


class History(NamedTuple):
    """Per frame (F,), filled by the pass; innovations of frame f start at ROOM * offsets[2 f]."""

    x: NDArray[np.float64]
    sd: NDArray[np.float64]
    nis: NDArray[np.float64]
    log_determinant: NDArray[np.float64]
    arcs: NDArray[np.int64]
    innovation: NDArray[np.float64]
    innovations: NDArray[np.int64]
    noise_scale: NDArray[np.float64]
    fixed: NDArray[np.bool_]
    matched: NDArray[np.int64]
    rejected: NDArray[np.int64]
    iterations: NDArray[np.int64]
    event: NDArray[np.int8]
    on_baseline: NDArray[np.bool_]


_FLAGS, _BYTES, _NUMBERS = boolean[::1], int8[::1], int64[::1]
_COLUMN, _TABLE, _CUBE, _STARS = float64[::1], float64[:, ::1], float64[:, :, ::1], int32[::1]
_LISTS = int32[:, ::1]


def _named(kind, *fields):
    return types.NamedTuple(fields, kind)


PASS_SIGNATURE = void(
    types.FunctionType(CAMERA_SIGNATURE),
    types.FunctionType(BIND),
    types.FunctionType(ROWS),
    types.FunctionType(UPDATE),
    types.FunctionType(PREDICT),
    types.FunctionType(COVARIANCE),
    _named(
        Telemetry, _NUMBERS, _COLUMN, _COLUMN, _COLUMN, _COLUMN, _TABLE, _CUBE, _COLUMN, _COLUMN
    ),
    _named(Baseline, _STARS, _TABLE, _CUBE, _BYTES),
    _named(
        Model, _COLUMN, float64, float64, float64, _NUMBERS, _COLUMN, _FLAGS, _COLUMN, _CUBE,
        _COLUMN, _COLUMN,
    ),
    _named(Rules, *[boolean] * 5, int64, float64, int64, *[float64] * 3),
    _named(
        Sky,
        _named(StarMap, _TABLE, _TABLE, _STARS, _STARS, int64, float64),
        _named(PairTable, float32[::1], _LISTS, _STARS, float64, float64),
    ),
    _named(Rule, *[float64] * 4, int64, int64, *[float64] * 3),
    _named(
        Work,
        _named(Slots, _TABLE, _COLUMN, _STARS, _STARS, _STARS),
        _named(Join, _STARS, *[_LISTS] * 4, _COLUMN),
    ),
    _named(
        State, _COLUMN, _TABLE, _COLUMN, _TABLE, _COLUMN, _TABLE, _COLUMN, _COLUMN, _COLUMN, _TABLE
    ),
    _named(Kept, _CUBE, float64[:, :, :, ::1], _TABLE, _CUBE, _NUMBERS),
    _named(
        History, _TABLE, _TABLE, _COLUMN, _COLUMN, _NUMBERS, _COLUMN, _NUMBERS, _COLUMN, _FLAGS,
        _NUMBERS, _NUMBERS, _NUMBERS, _BYTES, _FLAGS,
    ),
    _STARS,
    _TABLE,
)  # fmt: skip
