"""Figures 3, 4 and 5 of the study ``enright``, and how a sensor settles, as SVG text.

Each takes one sensor's study; None means that it holds nothing to draw.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from stcal.report.document import Document, Floats, columns, section
from stcal.report.enright_document import FILTERS
from stcal.report.format import fixed
from stcal.report.svg import (
    AFTER,
    BEFORE,
    FAINT,
    NEUTRAL,
    draw,
    plain_numbers,
    start_axes,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Colour and line of each filter; Okabe and Ito's green beside the two of all reports.
_STYLES: dict[str, dict[str, Any]] = {
    "q": {"color": BEFORE, "linestyle": "-", "lw": 1.2},
    "no_q": {"color": AFTER, "linestyle": "-", "lw": 2.0},
    "no_refit": {"color": "#009E73", "linestyle": "-.", "lw": 1.4},
}
# The range of a convergence plot is that after so many frames: the first ones fill any range.
_AFTER_FRAMES = 10
# How far above the lowest error Figure 4 reaches, as a factor.
_ERROR_RANGE = 1.12
_INNER_PX = 800.0


def _known(group: Document, *names: str) -> tuple[Floats, ...] | None:
    """Return the columns (N,) of a group, without rows that miss a number; None without any."""
    found = columns(group, *names)
    if found is None:
        return None
    good = np.isfinite(np.stack(found)).all(axis=0)
    return tuple(column[good] for column in found) if good.any() else None


def convergence(sensor: Document, name: str) -> str | None:
    """Figure 3: focal length minus batch value over frames, from both starts."""
    found = section(sensor, "convergence")
    panels = {start: _departures(found, start) for start in ("lab", "batch")}
    if not any(panels.values()):
        return None
    title = "Focal length minus the batch value over frames, from two starts"
    return draw(name, title, (9.6, 3.5), lambda f: _convergence_panels(f, panels))


def _departures(found: Document, start: str) -> dict[str, tuple[Floats, Floats, Floats]]:
    """Return frame, departure and sd [µm] by filter."""
    series = {}
    for key in FILTERS:
        group = {"frame": found.get("frame"), **section(found, start, key)}
        data = _known(group, "frame", "departure", "sd")
        if data is not None:
            series[key] = (data[0], 1e6 * data[1], 1e6 * data[2])
    return series


def _convergence_panels(
    figure: Figure, panels: dict[str, dict[str, tuple[Floats, Floats, Floats]]]
) -> None:
    titles = {
        "lab": "a) From the initial calibration",
        "batch": "b) From the batch calibration",
    }
    both = figure.subplots(1, 2, sharey=True)
    for axes, (start, series) in zip(both, panels.items(), strict=True):
        y = "f minus batch value [µm]" if start == "lab" else ""
        start_axes(axes, titles[start], "frame", y)
        for key, (frame, departure, sd) in series.items():
            axes.plot(frame, departure, label=FILTERS[key], **_STYLES[key])
            for sign in (-3.0, 3.0):
                bound = {**_STYLES[key], "linestyle": (0, (4, 3)), "lw": 0.7}
                axes.plot(frame, departure + sign * sd, **bound)
        axes.axhline(0.0, color=NEUTRAL, lw=0.7)
    limit = _settled_range([data for series in panels.values() for data in series.values()])
    both[0].set_ylim(-limit, limit)
    _legend(both[1])


def _settled_range(series: list[tuple[Floats, Floats, Floats]]) -> float:
    """Return the largest departure, with its bounds, after the first frames."""
    sizes = [(np.abs(d) + 3.0 * sd)[frame >= _AFTER_FRAMES] for frame, d, sd in series]
    return 1.05 * float(np.concatenate(sizes).max(initial=0.0)) or 1.0


def errors(sensor: Document, name: str) -> str | None:
    """Figure 4: tail RMS over frames and aggregate RMS, Q and No-Q."""
    found = section(sensor, "errors")
    series = {}
    for key in ("q", "no_q"):
        group = section(found, key)
        data = _known({"frame": found.get("frame"), **group}, "frame", "tail_urad")
        level = _known({"level": [group.get("aggregate_urad")]}, "level")
        # Both axes need numbers above zero.
        if data is not None and level is not None and min(map(np.min, (*data, *level))) > 0.0:
            series[key] = (data[0], data[1], float(level[0][0]))
    if not series:
        return None
    title = "RMS arclength error over frames, tail and aggregate"
    return draw(name, title, (7.6, 3.6), lambda f: _error_panel(f, series))


def _error_panel(figure: Figure, series: dict[str, tuple[Floats, Floats, float]]) -> None:
    axes = figure.add_subplot()
    start_axes(axes, "Error over the calibration set", "frame", "RMS [µrad]")
    lowest = []
    for key, (frame, tail, aggregate) in series.items():
        axes.plot(frame, tail, label=f"{FILTERS[key]}, tail", **_STYLES[key])
        label = f"{FILTERS[key]}, aggregate {fixed(aggregate, 1)}"
        level = {**_STYLES[key], "linestyle": "--", "lw": 1.1}
        axes.axhline(aggregate, label=label, **level)
        lowest += [aggregate, float(tail.min())]
    axes.set_xscale("log")
    plain_numbers(axes.xaxis)
    axes.set_ylim(0.99 * min(lowest), _ERROR_RANGE * min(lowest))
    _legend(axes)


def radial(sensor: Document, name: str) -> str | None:
    """Figure 5: net radial difference from the batch camera over the off-axis distance."""
    found = section(sensor, "radial")
    curves = {}
    for key in (*FILTERS, "true"):
        data = _known(found, "radius_px", key)
        if data is not None:
            curves[key] = data
    if not curves:
        return None
    title = "Radial difference from the batch camera"
    return draw(name, title, (7.6, 3.6), lambda f: _radial_panel(f, curves))


def _radial_panel(figure: Figure, curves: dict[str, tuple[Floats, ...]]) -> None:
    axes = figure.add_subplot()
    heading = "Combined effect of f, b4 and b2"
    start_axes(
        axes, heading, "distance from the boresight [px]", "outwards of the batch camera [px]"
    )
    true = {"color": NEUTRAL, "linestyle": ":", "lw": 1.4}
    for key, (radius, difference) in curves.items():
        label = FILTERS.get(key, "true camera")
        axes.plot(radius, difference, label=label, **_STYLES.get(key, true))
    axes.axhline(0.0, color=NEUTRAL, lw=0.7)
    axes.axvline(_INNER_PX, color=FAINT, lw=1.0)
    _legend(axes, "best")


def settling(sensor: Document, name: str) -> str | None:
    """Availability and error on the validation data after k frames of the No-Q filter."""
    found = _known(section(sensor, "settling"), "frame", "availability", "rms_urad")
    if found is None:
        return None
    title = "Availability and error over processed frames"
    return draw(name, title, (9.6, 3.0), lambda f: _settling_panels(f, *found))


def _settling_panels(figure: Figure, frame: Floats, share: Floats, error: Floats) -> None:
    left, right = figure.subplots(1, 2)
    start_axes(left, "Availability", "processed frames", "share of frames")
    start_axes(right, "Common-pair RMS", "processed frames", "RMS [µrad]")
    for axes, values in ((left, share), (right, error)):
        axes.plot(frame, values, "o-", color=AFTER, ms=3.5)
        axes.set_xscale("symlog", linthresh=1.0)
        plain_numbers(axes.xaxis)
        axes.margins(y=0.1)
    if error.min() > 0.0:
        right.set_yscale("log")
        plain_numbers(right.yaxis)


def _legend(axes: Axes, place: Any = "upper right") -> None:
    axes.legend(loc=place, handlelength=2.6)
