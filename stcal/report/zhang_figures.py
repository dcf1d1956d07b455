"""Figures 7 to 12 of the study ``zhang``, as SVG text; None where the document has nothing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from stcal.report.document import Document, Floats, columns, number, numbers, section, sections
from stcal.report.format import significant
from stcal.report.svg import (
    AFTER,
    BEFORE,
    FAINT,
    NEUTRAL,
    draw,
    plain_numbers,
    start_axes,
)
from stcal.report.zhang_content import NAMES, OURS, PAPER, SHORT
from stcal.units import unit_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_STYLES: dict[str, dict[str, Any]] = {
    PAPER: {"color": BEFORE, "lw": 1.4},
    OURS: {"color": AFTER, "lw": 1.6},
    "true": {"color": NEUTRAL, "lw": 1.2, "linestyle": "-."},
}
_BOUND: dict[str, Any] = {"color": NEUTRAL, "lw": 1.0, "linestyle": ":"}
_PUBLISHED: dict[str, Any] = {
    "color": "black", "marker": "D", "ms": 5.0, "linestyle": "none", "mfc": "white",
}  # fmt: skip
_LEVELS = 8

# Lines of a panel: label -> (x, y, style).
Lines = Mapping[str, tuple[Floats, Floats, dict[str, Any]]]


def convergence(document: Document, name: str) -> str | None:
    """Figures 7 and 8: errors of the five parameters over time."""
    panels = {parameter: _errors_over_time(document, parameter) for parameter in NAMES}
    title = "Errors of the five parameters over time"
    return _panels(panels, "time [s]", name, title)


def _errors_over_time(document: Document, parameter: str) -> Lines:
    group, size = section(document, "convergence"), unit_of(parameter).size
    t_s = numbers(group.get("t_s"))
    lines = {"bound of one run": (t_s, numbers(section(group, "bound").get(parameter)), _BOUND)}
    for key, label in SHORT.items():
        found = section(group, "filters", key)
        rms, sd, averaged = (
            numbers(section(found, kind).get(parameter)) for kind in ("rms", "sd", "averaged")
        )
        lines[f"{label}, RMS"] = (t_s, rms, _STYLES[key])
        if key == PAPER:
            thin = {**_STYLES[key], "lw": 0.9}
            lines[f"{label}, own sd"] = (t_s, sd, {**thin, "linestyle": "--"})
            lines[f"{label}, averaged"] = (t_s, np.abs(averaged), {**thin, "alpha": 0.6})
    paper = section(document, "paper")
    at = numbers([paper.get("calibration_s")])
    lines["published"] = (at, numbers([section(paper, "error").get(parameter)]), _PUBLISHED)
    return {label: (x, y / size, style) for label, (x, y, style) in lines.items()}


def noise_levels(document: Document, name: str) -> str | None:
    """Figure 11: RMS errors over the noise level."""
    levels = sections(document.get("noise_levels"))
    noise = numbers([level.get("noise_px") for level in levels])
    panels = {}
    for parameter in NAMES:
        size = unit_of(parameter).size
        bound = numbers([section(level, "bound").get(parameter) for level in levels])
        lines = {"bound of one run": (noise, bound / size, _BOUND)}
        for key, label in SHORT.items():
            rms = [section(level, "filters", key, "rms").get(parameter) for level in levels]
            marked = {**_STYLES[key], "marker": "o", "ms": 3.5}
            lines[f"{label}, RMS"] = (noise, numbers(rms) / size, marked)
        panels[parameter] = lines
    title = "Errors of the five parameters over the noise"
    return _panels(panels, "noise [px]", name, title, log_x=True)


def _panels(
    panels: Mapping[str, Lines], x: str, name: str, title: str, log_x: bool = False
) -> str | None:
    """Draw a panel per parameter; the sixth place holds the legend."""
    shown = {parameter: _drawable(lines) for parameter, lines in panels.items()}
    if not any(shown.values()):
        return None

    def plot(figure: Figure) -> None:
        places = figure.subplots(2, 3).ravel()
        for axes, (parameter, lines) in zip(places, shown.items(), strict=False):
            start_axes(axes, unit_of(parameter).label, x, "error")
            _draw_lines(axes, lines)
            _logarithmic(axes, lines, log_x)
        places[-1].axis("off")
        fullest = max(places, key=lambda axes: len(axes.lines))
        handles = fullest.get_legend_handles_labels()
        places[-1].legend(*handles, loc="center left", handlelength=2.6)

    return draw(name, title, (9.6, 5.2), plot)


def _drawable(lines: Lines) -> Lines:
    """Keep what has numbers above zero, which a logarithmic axis needs."""
    kept = {}
    for label, (x, y, style) in lines.items():
        if len(x) == len(y):
            good = np.isfinite(x) & np.isfinite(y) & (y > 0.0)
            if good.any():
                kept[label] = (x[good], y[good], style)
    return kept


def _draw_lines(axes: Axes, lines: Lines) -> None:
    for label, (x, y, style) in lines.items():
        axes.plot(x, y, label=label, **style)


def _logarithmic(axes: Axes, lines: Lines, log_x: bool = False) -> None:
    """Give the axes logarithmic scales with plain numbers, where there is anything to show."""
    if not lines:
        return
    axes.set_yscale("log")
    plain_numbers(axes.yaxis)
    # An averaged curve passes zero on its way.
    steady = [y.min() for label, (_, y, _) in lines.items() if "averaged" not in label]
    if steady:
        axes.set_ylim(bottom=0.5 * float(min(steady)))
    if log_x and all(float(x.min()) > 0.0 for x, _, _ in lines.values()):
        axes.set_xscale("log")
        plain_numbers(axes.xaxis)


def mean_square(document: Document, name: str) -> str | None:
    """Figure 9: mean square error of principal point and focal length over time."""
    group, paper = section(document, "mean_square"), section(document, "paper", "mean_square")
    t_s = numbers(group.get("t_s"))
    found = {key: section(group, "filters", key) for key in SHORT}
    lines = {"bound of one run": (t_s, numbers(section(group, "bound").get("optical")), _BOUND)}
    for key, label in SHORT.items():
        lines[f"{label}, single runs"] = (t_s, numbers(found[key].get("optical")), _STYLES[key])
    averaged = {**_STYLES[PAPER], "lw": 0.9, "linestyle": "--"}
    values = numbers(found[PAPER].get("averaged"))
    lines["Paper's filter, averaged curve"] = (t_s, values, averaged)
    lines["published"] = (numbers(paper.get("t_s")), numbers(paper.get("px2")), _PUBLISHED)
    shown = _drawable(lines)
    if not shown:
        return None

    def plot(figure: Figure) -> None:
        axes = figure.add_subplot()
        start_axes(axes, "Mean square of x0, y0 and f", "time [s]", "error squared [px²]")
        _draw_lines(axes, shown)
        _logarithmic(axes, shown)
        axes.legend(loc="upper right", handlelength=2.6)

    return draw(name, "Mean square error over time", (7.6, 3.6), plot)


def residual_distortion(document: Document, which: str, kind: str, name: str) -> str | None:
    """Figure 10: displacement of stars over the detector, ``distortion`` alone or whole ``image``.

    ``which`` is the filter.
    """
    found = section(document, "distortion", which)
    data = columns(found, "row_px", "col_px", kind)
    if data is None or not np.isfinite(np.stack(data)).all():
        return None
    shape = tuple(len(np.unique(line)) for line in data[:2])
    if min(shape) < 2 or shape[0] * shape[1] != len(data[0]):
        return None
    heading = f"{SHORT[which]}: largest {significant(float(data[2].max()), 2)} px"
    grid = np.stack(data).reshape(3, *shape)
    return draw(name, heading, (4.9, 4.4), lambda f: _map(f, grid, heading))


def _map(figure: Figure, grid: Floats, heading: str) -> None:
    row, col, moved = grid
    axes = figure.add_subplot()
    start_axes(axes, heading, "column y [px]", "row x [px]", grid="")
    axes.set_aspect("equal")
    # Equal values everywhere leave nothing to contour.
    if np.ptp(moved) > 0.0:
        filled = axes.contourf(col, row, moved, _LEVELS, cmap="Blues")
        bar = figure.colorbar(filled, ax=axes, shrink=0.85, label="RMS displacement [px]")
        bar.outline.set_visible(False)
    for spine in axes.spines.values():
        spine.set(visible=True, color=FAINT)


def mounting(document: Document, name: str) -> str | None:
    """Figure 12: errors of the mounting over time, by camera."""
    group, paper = section(document, "alignment"), section(document, "paper")
    t_s = numbers(group.get("t_s"))
    labels = {**SHORT, "true": "true camera"}
    at = numbers([paper.get("alignment_s")])
    panels = {}
    for key in ("element", "angle_deg"):
        lines = {
            label: (t_s, numbers(section(group, "cameras", c, "linear").get(key)), _STYLES[c])
            for c, label in labels.items()
        }
        value = number(section(paper, "alignment").get(key))
        lines["published"] = (at, numbers([value]), _PUBLISHED)
        panels[key] = _drawable(lines)
    if not any(panels.values()):
        return None
    title = "Errors of the mounting over time"
    return draw(name, title, (9.6, 3.3), lambda f: _mounting_panels(f, panels))


def _mounting_panels(figure: Figure, panels: Mapping[str, Lines]) -> None:
    headings = {"element": ("Elements of the matrix", ""), "angle_deg": ("Angles", "[deg]")}
    both = figure.subplots(1, 2)
    for axes, (key, lines) in zip(both, panels.items(), strict=True):
        heading, unit = headings[key]
        start_axes(axes, heading, "time [s]", f"mean absolute error {unit}".rstrip())
        _draw_lines(axes, lines)
        _logarithmic(axes, lines)
    handles = both[0].get_legend_handles_labels()
    if handles[0]:
        both[0].legend(*handles, loc="best", handlelength=2.6)
