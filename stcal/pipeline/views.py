"""What pictures are drawn from: residuals over the detector, and frames over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.frames import MatchedFrames
from stcal.metrics import cell_of, detector_cells, residual_vectors
from stcal.pipeline.numbers import numbers
from stcal.residuals.selection import StarSelection
from stcal.times import format_utc

Floats = NDArray[np.float64]

_SERIES_LENGTH = 1500
_RADIAL_BINS = 12


def residual_views(
    selections: Sequence[StarSelection], before: Camera, after: Camera
) -> dict[str, Any]:
    """Return the residual field by detector cell and its radial profile, under two cameras."""
    row, col = (
        np.concatenate([getattr(s, name) for s in selections]) for name in ("row_px", "col_px")
    )
    vectors = [
        np.concatenate([residual_vectors(s, c) for s in selections]) for c in (before, after)
    ]
    good = np.isfinite(vectors[0]).all(axis=1) & np.isfinite(vectors[1]).all(axis=1)
    row, col, old, new = row[good], col[good], vectors[0][good], vectors[1][good]
    return {
        "field": _field(row, col, old, new, after),
        "radial": _radial(row, col, old, new, after),
    }


def _field(row: Floats, col: Floats, old: Floats, new: Floats, camera: Camera) -> dict[str, Any]:
    cells = detector_cells(camera.rows, camera.cols)
    cell = cell_of(row, col, camera, cells)
    size = cells[0] * cells[1]
    count = np.bincount(cell, minlength=size)
    used = np.flatnonzero(count)

    def mean(values: Floats) -> list[Any]:
        return numbers((np.bincount(cell, values, minlength=size) / np.maximum(count, 1))[used])

    i, j = np.divmod(used, cells[1])
    return {
        "rows": camera.rows,
        "cols": camera.cols,
        "row_px": numbers((i + 0.5) * camera.rows / cells[0] - 0.5),
        "col_px": numbers((j + 0.5) * camera.cols / cells[1] - 0.5),
        "count": count[used].tolist(),
        "before_row_px": mean(old[:, 0]),
        "before_col_px": mean(old[:, 1]),
        "after_row_px": mean(new[:, 0]),
        "after_col_px": mean(new[:, 1]),
    }


def _radial(row: Floats, col: Floats, old: Floats, new: Floats, camera: Camera) -> dict[str, Any]:
    """Mean radial component of the residuals over the distance from the detector's centre."""
    y, x = row - 0.5 * (camera.rows - 1), col - 0.5 * (camera.cols - 1)
    radius = np.hypot(x, y)
    unit = np.stack([y, x], axis=1) / np.maximum(radius, 1e-9)[:, None]
    edge = 0.5 * math.hypot(camera.rows, camera.cols) / _RADIAL_BINS
    which = np.minimum((radius / edge).astype(int), _RADIAL_BINS - 1)
    count = np.bincount(which, minlength=_RADIAL_BINS)
    used = np.flatnonzero(count >= 3)

    def mean(values: Floats) -> Floats:
        return np.bincount(which, values, minlength=_RADIAL_BINS) / np.maximum(count, 1)

    along_old, along_new = (old * unit).sum(axis=1), (new * unit).sum(axis=1)
    centre = mean(along_new)
    variance = mean((along_new - centre[which]) ** 2)
    return {
        "radius_px": numbers((used + 0.5) * edge),
        "before_px": numbers(mean(along_old)[used]),
        "after_px": numbers(centre[used]),
        "sd_after_px": numbers(np.sqrt(variance)[used]),
        "count": count[used].tolist(),
    }


def series(
    before: Sequence[MatchedFrames],
    after: Sequence[MatchedFrames],
    counts: tuple[str, str],
    fixes: tuple[str, str],
    shown: NDArray[np.bool_] | None = None,
) -> dict[str, Any]:
    """Return matched stars (both exposures) and fixes over time, thinned for plotting.

    ``shown`` (F,) masks the frames that count; all of them without it.
    """
    times = np.concatenate([m.frames.t_tai_ns for m in before])
    frames = np.arange(len(times)) if shown is None else np.flatnonzero(shown)
    frames = frames[:: max(1, math.ceil(len(frames) / _SERIES_LENGTH))]
    document: dict[str, Any] = {"time_utc": [format_utc(int(t)) for t in times[frames]]}
    for name, matched in zip(counts, (before, after), strict=True):
        document[name] = np.concatenate([m.matches_per_frame for m in matched])[frames].tolist()
    for name, matched in zip(fixes, (before, after), strict=True):
        document[name] = np.concatenate([m.frame_solved for m in matched])[frames].tolist()
    return document
