"""The figure of an alignment: how the estimates converge, as SVG text."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stcal.report.document import Document, Floats, matrix, numbers, section
from stcal.report.svg import (
    AFTER,
    BEFORE,
    NEUTRAL,
    draw,
    plain_numbers,
    start_axes,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = {"linear": BEFORE, "multiplicative": AFTER}
# Estimates of fewer frames don't set the scale.
_SETTLING_FRAMES = 10


def convergence(document: Document, name: str) -> str | None:
    """Each method's departure from its last estimate, about the axes of S, within 3 sd."""
    history = section(document, "history")
    elapsed, frames = numbers(history.get("elapsed_s")), numbers(history.get("frames"))
    lines = {}
    for method in _COLOURS:
        found = section(history, method)
        columns = (matrix(found.get(k), 3) for k in ("departure_arcsec", "sd_arcsec"))
        departure, sd = columns
        if departure is not None and sd is not None and len(departure) == len(sd) == len(elapsed):
            lines[method] = (departure, sd)
    known = np.isfinite(elapsed) & (elapsed > 0.0)
    if not lines or len(frames) != len(elapsed) or not known.any():
        return None
    title = "Convergence of the misalignment about the axes of S"
    shown = {m: (departure[known], sd[known]) for m, (departure, sd) in lines.items()}
    return draw(name, title, (8.4, 3.2), lambda f: _panels(f, elapsed[known], frames[known], shown))


def _panels(
    figure: Figure, elapsed: Floats, frames: Floats, lines: dict[str, tuple[Floats, Floats]]
) -> None:
    settled = frames >= min(_SETTLING_FRAMES, frames[-1])
    for k, axes in enumerate(figure.subplots(1, 3)):
        unit = "departure, band ±3 sd [arcsec]" if k == 0 else ""
        start_axes(axes, f"About {'xyz'[k]}", "time [s]", unit)
        axes.set_xscale("log")
        plain_numbers(axes.xaxis)
        axes.minorticks_off()
        for method, (departure, sd) in lines.items():
            _line(axes, elapsed, departure[:, k], 3.0 * sd[:, k], method)
        height = max(float((3.0 * sd[settled, k]).max()) for _, sd in lines.values())
        if height > 0.0:
            axes.set_ylim(-1.3 * height, 1.3 * height)
        axes.axhline(0.0, color=NEUTRAL, lw=0.7)
        if k == 2:
            axes.legend(loc="lower right")


def _line(axes: Axes, x: Floats, y: Floats, width: Floats, method: str) -> None:
    colour, style = _COLOURS[method], "--" if method == "linear" else "-"
    axes.plot(x, y, style, color=colour, label=method)
    axes.plot(x, width, ":", color=colour, lw=0.9)
    axes.plot(x, -width, ":", color=colour, lw=0.9)
