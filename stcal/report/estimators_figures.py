"""The two plots of the study ``estimators`` as SVG text; None where there is nothing to draw."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from stcal.report.document import Document, Floats, number, numbers, section, sections, text
from stcal.report.estimators_content import combination_of, sensors
from stcal.report.format import share, significant
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

# residual, estimator, time, error
Point = tuple[str, str, float, float]
# Okabe and Ito's palette: colours are residuals, markers estimators.
_COLOURS = (AFTER, "#009E73", BEFORE, "#CC79A7")
_MARKERS = ("s", "^", "o", "v", "D")


def accuracy_and_time(document: Document, name: str) -> str | None:
    """Error over the bound against time per frame, a panel for each camera."""
    found = [(camera, points) for camera in sensors(document) if (points := _points(camera))]
    if not found:
        return None
    title = "Error over the bound against time per frame"
    return draw(name, title, (9.6, 3.9), lambda f: _accuracy_panels(f, found))


def _points(camera: Document) -> list[Point]:
    """Return (residual, estimator, time, error) of the combinations that have both."""
    found = []
    for row in sections(camera.get("combinations")):
        seconds, error = number(row.get("us_per_frame")), number(row.get("over_bound"))
        if seconds is not None and error is not None and seconds > 0.0 < error:
            found.append((text(row.get("residual")), text(row.get("estimator")), seconds, error))
    return found


def _accuracy_panels(figure: Figure, found: Sequence[tuple[Document, list[Point]]]) -> None:
    panels = figure.subplots(1, len(found), squeeze=False)[0]
    # In the order in which they first occur.
    residuals, estimators = (
        list(dict.fromkeys(str(point[k]) for _, points in found for point in points))
        for k in (0, 1)
    )
    for axes, (camera, points) in zip(panels, found, strict=True):
        first = axes is panels[0]
        start_axes(axes, text(camera.get("camera")), "µs a frame", "error / bound" * first)
        axes.set_xscale("log")
        for residual, estimator, seconds, error in points:
            axes.plot(seconds, error, **_style(residual, estimator, residuals, estimators))
        efficient = number(camera.get("efficient_over_bound"))
        if efficient is not None:
            axes.axhline(efficient, color=NEUTRAL, lw=0.9, ls=":")
        _plain_ticks(axes)
    figure.legend(
        handles=_handles(residuals, estimators), loc="outside lower center",
        ncols=len(residuals) + len(estimators) + 1, handlelength=1.2, columnspacing=1.0,
    )  # fmt: skip


def _style(
    residual: str, estimator: str, residuals: list[str], estimators: list[str]
) -> dict[str, Any]:
    colour = _COLOURS[residuals.index(residual) % len(_COLOURS)]
    marker = _MARKERS[estimators.index(estimator) % len(_MARKERS)]
    return {"color": colour, "marker": marker, "ls": "none", "ms": 5.0, "mfc": "none", "mew": 1.2}


def _plain_ticks(axes: Axes) -> None:
    from matplotlib.ticker import LogLocator

    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    plain_numbers(axes.xaxis)


def _handles(residuals: list[str], estimators: list[str]) -> list[Any]:
    from matplotlib.lines import Line2D

    colours = [
        Line2D([], [], color=_COLOURS[k % len(_COLOURS)], lw=3.0, label=name)
        for k, name in enumerate(residuals)
    ]
    markers = [
        Line2D([], [], label=name, ls="none", marker=_MARKERS[k % len(_MARKERS)], color=NEUTRAL,
               mfc="none")
        for k, name in enumerate(estimators)
    ]  # fmt: skip
    bound = Line2D([], [], color=NEUTRAL, lw=0.9, ls=":", label="efficient")
    return [*colours, *markers, bound]


def robustness(document: Document, name: str) -> str | None:
    """Share of runs that end well, by combination: under bad starts and with false matches."""
    found = section(document, "robustness")
    rows = sections(found.get("combinations"))
    panels = [
        ("Bad start [σ]", [significant(v, 3) for v in numbers(found.get("start_sigma"))],
         _shares(rows, "starts")),
        ("False matches", [share(float(v)) for v in numbers(found.get("false_shares"))],
         _shares(rows, "false_matches")),
    ]  # fmt: skip
    if not rows or any(table is None or table.shape[1] != len(x) for _, x, table in panels):
        return None
    names = [combination_of(row) for row in rows]
    title = "Share of runs that end well, under bad starts and with false matches"
    return draw(name, title, (9.0, 0.4 + 0.24 * (len(rows) + 2)),
                lambda f: _robustness_panels(f, names, panels))  # fmt: skip


def _shares(rows: list[Document], kind: str) -> Floats | None:
    shares = [numbers(section(row, kind).get("well")) for row in rows]
    return np.array(shares) if len({len(row) for row in shares}) == 1 else None


def _robustness_panels(figure: Figure, names: list[str], panels: list[Any]) -> None:
    widths = [len(labels) for _, labels, _ in panels]
    both = figure.subplots(1, 2, sharey=True, width_ratios=widths)
    for axes, (heading, labels, table) in zip(both, panels, strict=True):
        start_axes(axes, heading, "", "", grid="")
        axes.pcolormesh(table, cmap="Blues", vmin=0.0, vmax=1.25, edgecolors="white", lw=1.0)
        for (row, col), value in np.ndenumerate(table):
            shown = f"{100.0 * value:.0f}" if np.isfinite(value) else ""
            axes.text(col + 0.5, row + 0.5, shown, ha="center", va="center", fontsize=8.0,
                      color="white" if value > 0.6 else "#222222")  # fmt: skip
        axes.set_xticks(np.arange(len(labels)) + 0.5, labels)
        axes.tick_params(length=0.0)
        for spine in axes.spines.values():
            spine.set_visible(False)
    both[0].set_yticks(np.arange(len(names)) + 0.5, names)
    both[0].invert_yaxis()
