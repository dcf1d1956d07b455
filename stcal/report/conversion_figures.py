"""The figure of a conversion's report: its error over the detector, as SVG text."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stcal.report.document import Document, Floats, columns, number
from stcal.report.format import significant
from stcal.report.svg import FAINT, NEUTRAL, draw, start_axes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Below this [µrad] there is nothing to see but rounding.
_LEAST_URAD = 1e-3
_LEVELS = 8
# Arrows along the longer side of the detector.
_ARROWS = 15


def error_map(field: Document, name: str) -> str | None:
    """Size of the directions' error as a heat map, with arrows of the centroids' error.

    None where the section holds no whole grid, or no error worth showing.
    """
    found = columns(field, "row_px", "col_px", "error_urad", "error_row_px", "error_col_px")
    rows, cols = number(field.get("rows")), number(field.get("cols"))
    if found is None or not rows or not cols or min(rows, cols) < 1 or max(rows, cols) > 1e6:
        return None
    cells = np.stack(found)
    shape = tuple(len(np.unique(line)) for line in cells[:2])
    if not np.isfinite(cells).all() or min(shape) < 2 or shape[0] * shape[1] != cells.shape[1]:
        return None
    if not cells[2].max() >= _LEAST_URAD:
        return None
    height = 0.9 + 4.6 * min(max(rows / cols, 0.3), 1.6)
    title = "Error of the conversion over the detector"
    return draw(name, title, (6.2, height), lambda f: _map(f, cells.reshape(5, *shape)))


def _map(figure: Figure, grid: Floats) -> None:
    row, col, urad, d_row, d_col = grid
    axes = figure.add_subplot()
    largest = float(np.hypot(d_row, d_col).max())
    heading = f"Longest arrow {significant(largest, 2)} px"
    start_axes(axes, heading, "column n [px]", "row m [px]", grid="")
    axes.set_aspect("equal")
    filled = axes.contourf(col, row, urad, _LEVELS, cmap="Blues")
    bar = figure.colorbar(filled, ax=axes, shrink=0.85, label="error of the direction [µrad]")
    bar.outline.set_visible(False)
    if largest > 0.0:
        every = max(1, max(grid.shape[1:]) // _ARROWS)
        thin = (slice(every // 2, None, every), slice(every // 2, None, every))
        spacing = float(np.ptp(col)) / _ARROWS
        axes.quiver(
            col[thin], row[thin], d_col[thin], d_row[thin], color=NEUTRAL, angles="xy",
            scale_units="xy", scale=largest / (1.2 * spacing), minlength=0.0, width=0.0035,
        )  # fmt: skip
    for spine in axes.spines.values():
        spine.set(visible=True, color=FAINT)
