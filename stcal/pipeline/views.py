"""What pictures are drawn from: residuals over the detector, and frames over time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.metrics import cell_of, detector_cells, residual_vectors
from stcal.pipeline.identifying import Series
from stcal.pipeline.numbers import numbers
from stcal.pipeline.sums import Sums
from stcal.residuals.selection import StarSelection
from stcal.times import format_utc

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_RADIAL_BINS = 12


@dataclass(frozen=True)
class ViewSums(Sums):
    """Residuals (measured minus predicted centroids) under two cameras, summed.

    Attributes
    ----------
    count, field : (C,) stars and (C, 4) sums by detector cell: row and column before, then after
    radial_count, radial : (R,) stars and (R, 3) sums by distance from the detector's centre: the
        radial component before, after, and after squared
    """

    count: Ints
    field: Floats
    radial_count: Ints
    radial: Floats


def view_sums(stars: StarSelection, before: Camera, after: Camera) -> ViewSums:
    """Sum the residuals of stars whose attitude is known under both cameras."""
    both = np.hstack([residual_vectors(stars, camera) for camera in (before, after)])
    good = np.isfinite(both).all(axis=1)
    row, col, both = stars.row_px[good], stars.col_px[good], both[good]
    cells = detector_cells(after.rows, after.cols)
    count, field = _binned(cell_of(row, col, after, cells), both, cells[0] * cells[1])
    y, x = _from_centre(row, col, after)
    radius = np.hypot(x, y)
    unit = np.stack([y, x], axis=1) / np.maximum(radius, 1e-9)[:, None]
    ring = np.minimum((radius / _ring_px(after)).astype(int), _RADIAL_BINS - 1)
    old, new = (both[:, :2] * unit).sum(axis=1), (both[:, 2:] * unit).sum(axis=1)
    rings, radial = _binned(ring, np.stack([old, new, new * new], axis=1), _RADIAL_BINS)
    return ViewSums(count, field, rings, radial)


def _binned(where: Ints, values: Floats, size: int) -> tuple[Ints, Floats]:
    """Return the number and the sums of values (K, V) in each of ``size`` places."""
    sums = [np.bincount(where, column, minlength=size) for column in values.T]
    return np.bincount(where, minlength=size), np.stack(sums, axis=1).astype(np.float64)


def _from_centre(row: Floats, col: Floats, camera: Camera) -> tuple[Floats, Floats]:
    return row - 0.5 * (camera.rows - 1), col - 0.5 * (camera.cols - 1)


def _ring_px(camera: Camera) -> float:
    return 0.5 * math.hypot(camera.rows, camera.cols) / _RADIAL_BINS


def residual_views(sums: ViewSums, camera: Camera) -> dict[str, Any]:
    """Return the residual field by detector cell and its radial profile, under two cameras."""
    return {"field": _field(sums, camera), "radial": _radial(sums, camera)}


def _field(sums: ViewSums, camera: Camera) -> dict[str, Any]:
    cells = detector_cells(camera.rows, camera.cols)
    used = np.flatnonzero(sums.count)
    mean = sums.field[used] / sums.count[used, None]
    i, j = np.divmod(used, cells[1])
    return {
        "rows": camera.rows,
        "cols": camera.cols,
        "row_px": numbers((i + 0.5) * camera.rows / cells[0] - 0.5),
        "col_px": numbers((j + 0.5) * camera.cols / cells[1] - 0.5),
        "count": sums.count[used].tolist(),
        "before_row_px": numbers(mean[:, 0]),
        "before_col_px": numbers(mean[:, 1]),
        "after_row_px": numbers(mean[:, 2]),
        "after_col_px": numbers(mean[:, 3]),
    }


def _radial(sums: ViewSums, camera: Camera) -> dict[str, Any]:
    """Mean radial component of the residuals over the distance from the detector's centre."""
    used = np.flatnonzero(sums.radial_count >= 3)
    before, after, squares = (sums.radial[used] / sums.radial_count[used, None]).T
    return {
        "radius_px": numbers((used + 0.5) * _ring_px(camera)),
        "before_px": numbers(before),
        "after_px": numbers(after),
        "sd_after_px": numbers(np.sqrt(np.maximum(squares - after**2, 0.0))),
        "count": sums.radial_count[used].tolist(),
    }


def series(
    before: Series, after: Series, counts: tuple[str, str], fixes: tuple[str, str]
) -> dict[str, Any]:
    """Return matched stars (both exposures) and fixes over time, as they are plotted."""
    document: dict[str, Any] = {"time_utc": [format_utc(int(t)) for t in before.t_tai_ns]}
    for name, one in zip(counts, (before, after), strict=True):
        document[name] = one.matched.tolist()
    for name, one in zip(fixes, (before, after), strict=True):
        document[name] = one.fixed.tolist()
    return document
