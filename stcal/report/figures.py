"""Figures of both reports: the detector and the time line, as SVG text.

Each takes a section of the document; None means that it holds nothing to draw.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from stcal.report.content import weighted_rms
from stcal.report.document import (
    Document,
    Floats,
    columns,
    flags,
    number,
    numbers,
    sequence,
)
from stcal.report.format import significant
from stcal.report.svg import AFTER, BEFORE, FAINT, NEUTRAL, draw, start_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Cells with fewer stars than this are drawn faint: their mean is mostly noise.
_FEW_STARS = 5
_SHORTEST_SPAN_DAYS = 1.0 / 24.0
_MOST_POINTS = 300
_MOST_CELLS = 900


def residual_field(field: Document, which: str, label: str, name: str) -> str | None:
    """Mean residual vectors over the detector; ``which`` is ``before`` or ``after``."""
    keys = ("row_px", "col_px", f"{which}_row_px", f"{which}_col_px", "count")
    found = columns(field, *keys)
    rows, cols = number(field.get("rows")), number(field.get("cols"))
    if found is None or not rows or not cols or min(rows, cols) < 1 or max(rows, cols) > 1e6:
        return None
    cells = np.stack(found)
    cells = cells[:, np.isfinite(cells[:4]).all(axis=0)]
    if cells.shape[1] == 0:
        return None
    # A finer grid than this is unreadable; keep every k-th cell.
    cells = cells[:, :: math.ceil(cells.shape[1] / _MOST_CELLS)]
    height = 0.9 + 4.1 * min(max(rows / cols, 0.3), 1.6)
    title = f"Mean residual vectors over the detector, {label}"
    return draw(name, title, (4.9, height), lambda f: _quiver(f, cells, rows, cols, label))


def _quiver(figure: Figure, cells: Floats, rows: float, cols: float, label: str) -> None:
    row, col, d_row, d_col, stars = cells
    size = np.hypot(d_row, d_col)
    axes = figure.add_subplot()
    heading = f"{label.capitalize()}: RMS {significant(weighted_rms(size, stars), 2)} px"
    start_axes(axes, heading, "column n [px]", "row m [px]", grid="")
    axes.set_aspect("equal")
    # The largest arrow spans about one cell; the margin keeps arrows of edge cells inside.
    cell = math.sqrt(rows * cols / max(cells.shape[1], 1))
    known = size[stars >= _FEW_STARS]
    largest = float(np.max(known if known.size else size)) or 1.0
    per_px = 1.1 * cell / largest
    margin = 0.1 * max(rows, cols)
    axes.set_xlim(-0.5 - margin, cols - 0.5 + margin)
    axes.set_ylim(-0.5 - margin, rows - 0.5 + margin)
    outline = np.array([[-0.5, -0.5], [cols - 0.5, -0.5], [cols - 0.5, rows - 0.5]])
    corners = np.vstack([outline, [[-0.5, rows - 0.5], [-0.5, -0.5]]])
    axes.plot(corners[:, 0], corners[:, 1], color=FAINT, lw=0.9)
    colour = BEFORE if label in ("initial", "baseline") else AFTER
    colours = np.where(stars < _FEW_STARS, FAINT, colour)
    shape: dict[str, Any] = {
        "width": 0.0045,
        "headwidth": 3.6,
        "headlength": 4.2,
        "headaxislength": 3.8,
    }
    axes.quiver(
        col, row, d_col, d_row, color=colours.tolist(), angles="xy", scale_units="xy",
        scale=1.0 / per_px, minlength=0.0, **shape,
    )  # fmt: skip
    _scale_key(axes, _round_length(largest), per_px, (rows, cols, margin), shape)


def _scale_key(
    axes: Axes, length_px: float, per_px: float, extent: tuple[float, float, float], shape: Any
) -> None:
    """Draw the arrow that tells the scale, above the upper right corner."""
    rows, cols, margin = extent
    x, y = cols - 0.5 + margin - length_px * per_px, rows - 0.5 + 1.75 * margin
    axes.quiver(
        [x], [y], [length_px * per_px], [0.0], color="black", angles="xy", scale_units="xy",
        scale=1.0, clip_on=False, **shape,
    )  # fmt: skip
    axes.annotate(
        f"{length_px:g} px", (x, y), xytext=(-5, 0), textcoords="offset points", ha="right",
        va="center", fontsize=8.5, annotation_clip=False,
    )  # fmt: skip


def _round_length(largest: float) -> float:
    """Return 1, 2 or 5 times a power of ten, not above the largest arrow."""
    power = 10.0 ** math.floor(math.log10(largest))
    step = next(s for s in (5.0, 2.0, 1.0) if s * power <= largest * (1 + 1e-12))
    return float(f"{step * power:.3g}")


def radial_profile(radial: Document, labels: tuple[str, str], name: str) -> str | None:
    """Mean radial residual over the distance from the detector's centre."""
    found = columns(radial, "radius_px", "before_px", "after_px")
    if found is None or not np.isfinite(found[0]).any():
        return None
    scatter = columns(radial, "sd_after_px", "count", "radius_px")
    sd = np.zeros(len(found[0]))
    if scatter is not None and len(scatter[0]) == len(sd):
        sd = np.abs(np.nan_to_num(scatter[0] / np.sqrt(np.maximum(scatter[1], 1.0))))
    title = f"Mean radial residual, {labels[0]} and {labels[1]}"
    return draw(name, title, (7.2, 3.0), lambda f: _profiles(f, found, sd, labels))


def _profiles(
    figure: Figure, found: tuple[Floats, ...], sd: Floats, labels: tuple[str, str]
) -> None:
    radius, before, after = found
    both, zoomed = figure.subplots(1, 2)
    x = "distance from the centre [px]"
    start_axes(both, "Radial residual", x, "mean, outwards [px]")
    both.plot(radius, before, "s--", color=BEFORE, ms=3.5, label=labels[0])
    both.plot(radius, after, "o-", color=AFTER, ms=3.5, label=labels[1])
    both.legend(loc="best")
    start_axes(zoomed, f"{labels[1].capitalize()} alone, ±1 sd of the mean", x, "")
    zoomed.errorbar(
        radius, after, yerr=sd, fmt="o-", color=AFTER, ms=3.5, elinewidth=0.9,
        capsize=2,
    )  # fmt: skip
    for axes in (both, zoomed):
        axes.axhline(0.0, color=NEUTRAL, lw=0.7)
        axes.margins(y=0.12)


def matched_over_time(series: Document, labels: tuple[str, str], name: str) -> str | None:
    """Matched stars of each frame over time, and the frames without a fix."""
    times = _times(series.get("time_utc"))
    stars = [numbers(series.get(f"matched_{label}")) for label in labels]
    fixes = [flags(series.get(f"fix_{label}")) for label in labels]
    if times is None or any(len(column) != len(times) for column in (*stars, *fixes)):
        return None
    title = f"Matched stars over time, {labels[0]} and {labels[1]}"
    return draw(name, title, (8.4, 3.9), lambda f: _time_panels(f, times, stars, fixes, labels))


def _time_panels(
    figure: Figure, times: Any, stars: list[Floats], fixes: list[Any], labels: tuple[str, str]
) -> None:
    import matplotlib.dates

    dates: Any = matplotlib.dates  # not typed
    x = (times - times[0]) / np.timedelta64(1, "D") + dates.date2num(times[0])
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(5, 1.0))
    binned = len(x) > _MOST_POINTS
    heading = "Matched stars per frame" + (", mean over intervals" if binned else "")
    start_axes(upper, heading, "", "stars")
    for values, label, colour, marker in zip(stars, labels, (BEFORE, AFTER), "so", strict=True):
        at, mean = _thinned(x, values)
        upper.plot(at, mean, marker, color=colour, ms=2.6, mew=0, label=label)
    top = 1.1 * max(1.0, *(float(line.get_ydata().max(initial=1.0)) for line in upper.lines))
    upper.set_ylim(-0.05 * top, top)
    upper.tick_params(axis="x", length=0)
    upper.spines["bottom"].set_visible(False)
    upper.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, markerscale=2.0)
    start_axes(lower, "Frames without a fix", "time [UTC]", "", grid="")
    for place, fix, colour in zip((1, 0), fixes, (BEFORE, AFTER), strict=True):
        _rug(lower, x, ~fix, place, colour)
    shares = [
        f"{label} {100 * (1 - fix.mean()):.1f} %" for label, fix in zip(labels, fixes, strict=True)
    ]
    lower.set_yticks((1, 0), shares)
    lower.set_ylim(-0.6, 1.6)
    lower.tick_params(axis="y", length=0)
    # Never a range of seconds, nor the years that matplotlib shows around a single frame.
    span = float(np.ptp(x))
    margin = max(0.03 * span, 0.5 * (_SHORTEST_SPAN_DAYS - span))
    lower.set_xlim(x.min() - margin, x.max() + margin)
    locator = dates.AutoDateLocator()
    lower.xaxis.set_major_locator(locator)
    lower.xaxis.set_major_formatter(dates.ConciseDateFormatter(locator))


def _thinned(x: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return the points, or their means over equal intervals when they are too many to see."""
    good = np.isfinite(values)
    x, values = x[good], values[good]
    if len(x) <= _MOST_POINTS:
        return x, values
    span = float(np.ptp(x)) or 1.0
    place = np.minimum(((x - x.min()) / span * _MOST_POINTS).astype(np.int64), _MOST_POINTS - 1)
    stars = np.bincount(place, minlength=_MOST_POINTS)
    full = stars > 0
    at = np.bincount(place, x, _MOST_POINTS)[full] / stars[full]
    return at, np.bincount(place, values, _MOST_POINTS)[full] / stars[full]


def _rug(axes: Axes, x: Floats, marked: Any, place: float, colour: str) -> None:
    """Draw one tick per marked frame, as a single path; ticks that coincide are drawn once."""
    if not marked.any():
        return
    span = float(np.ptp(x)) or 1.0
    bins = np.round((x[marked] - x.min()) / span * 600)
    at = x[marked][np.unique(bins, return_index=True)[1]]
    ends = np.tile([place - 0.38, place + 0.38, np.nan], len(at))
    axes.plot(np.repeat(at, 3), ends, color=colour, lw=0.9, solid_capstyle="butt")


def _times(value: Any) -> Any:
    """Return (F,) datetime64[ms] of ISO times with ``Z``, or None."""
    items = sequence(value)
    try:
        found = np.array([str(item).removesuffix("Z") for item in items], dtype="datetime64[ms]")
    except ValueError:
        return None
    years = found.astype("datetime64[Y]").astype(np.int64) + 1970
    return found if len(found) and ((years > 1900) & (years < 2500)).all() else None
