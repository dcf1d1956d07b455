"""Figures of a sequential fit's report: how the filter converges, and how it does, as SVG text.

Each takes the document; None means that it holds nothing to draw.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from stcal.report.document import Document, Floats, columns, flags, number, section, text
from stcal.report.format import measured, spread
from stcal.report.svg import AFTER, BEFORE, FAINT, NEUTRAL, draw, start_axes
from stcal.units import unit_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_PANELS = 16
# Points of a curve, closer in the first frames, where an estimate changes the most.
_MOST_POINTS = 160
_MOST_FRAMES = 600
_TICKS = (1, 10, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000, 50_000, 100_000, 1_000_000)
# Two-sided 95 % of the normal distribution.
_NORMAL_95 = 1.96
_WITHIN_SD = 3.0


@dataclass(frozen=True)
class Trace:
    """One parameter over the frames, in units of its sd at the end.

    ``frame`` (N,) counts from one; ``departure`` (N,) from the last value; ``sd`` (N,).
    """

    label: str
    frame: Floats
    departure: Floats
    sd: Floats


def convergence(document: Document, name: str) -> str | None:
    """Each estimated parameter's departure from its last value, with the 3-sigma band."""
    history = section(document, "sequential", "history")
    count = number(section(document, "sequential").get("frames"))
    listed = section(history, "parameters")
    found = [_trace(text(key), section(listed, key), count) for key in listed]
    traces = [trace for trace in found if trace is not None][:_MOST_PANELS]
    if not traces:
        return None
    rows = math.ceil(len(traces) / 2)
    title = "Departure of each parameter from its last value over the frames"
    return draw(name, title, (8.4, 0.5 + 1.55 * rows), lambda f: _convergence(f, traces, rows))


def _trace(name: str, series: Document, count: float | None) -> Trace | None:
    found = columns(series, "value", "sd")
    if found is None:
        return None
    value, sd = found
    last = sd[-1]
    if not (np.isfinite(value[-1]) and last > 0.0):
        return None
    unit = unit_of(name)
    shown = measured(value[-1] / unit.size, last / unit.size)
    label = f"{unit.symbol}: {shown} ± {spread(last / unit.size)} {unit.shown}".rstrip()
    points = _thinned(len(value))
    frame = _frames(len(value), count)[points]
    with np.errstate(over="ignore", invalid="ignore"):
        return Trace(label, frame, (value[points] - value[-1]) / last, sd[points] / last)


def _thinned(count: int) -> Any:
    """Return places of at most _MOST_POINTS of ``count`` points, evenly spaced in their root."""
    roots = np.linspace(0.0, math.sqrt(count - 1), min(count, _MOST_POINTS))
    return np.unique(np.round(roots**2).astype(np.int64))


def _frames(count: int, total: float | None) -> Floats:
    """Return frame numbers (count,), from one: the history is thinned evenly."""
    last = total if total is not None and count <= total < 1e12 else count
    return np.linspace(1.0, last, count)


def _convergence(figure: Figure, traces: list[Trace], rows: int) -> None:
    panels = figure.subplots(rows, 2, sharex=True, sharey=True, squeeze=False)
    for place, axes in enumerate(panels.flat):
        if place >= len(traces):
            axes.set_visible(False)
            continue
        trace = traces[place]
        start_axes(axes, "", "", "departure [sd]" if place % 2 == 0 else "")
        axes.set_title(trace.label, fontsize=9.0)
        bound = _WITHIN_SD * trace.sd
        axes.fill_between(trace.frame, -bound, bound, color=FAINT, alpha=0.55, lw=0)
        axes.axhline(0.0, color=NEUTRAL, lw=0.6)
        axes.plot(trace.frame, trace.departure, color=AFTER, lw=1.1)
        axes.label_outer()
    _scales(panels[0, 0], traces)
    for axes in panels.flat[max(len(traces) - 2, 0) : len(traces)]:
        axes.set_xlabel("frame")
        axes.tick_params(axis="x", labelbottom=True)


def _scales(axes: Axes, traces: list[Trace]) -> None:
    """Give all panels a scale that shows the first frames and the last ones alike."""
    axes.set_yscale("symlog", linthresh=_WITHIN_SD, linscale=1.0)
    sizes = np.concatenate([np.abs(t.departure) for t in traces] + [3.0 * t.sd for t in traces])
    largest = max(float(np.nanmax(np.where(np.isfinite(sizes), sizes, 0.0))), _WITHIN_SD)
    decades = math.ceil(math.log10(largest / _WITHIN_SD) + 1e-9)
    step = math.ceil(decades / 3)
    powers = [_WITHIN_SD * 10.0**k for k in range(0, decades, step)]
    ticks = [-tick for tick in reversed(powers)] + [0.0, *powers]
    axes.set_ylim(-1.2 * largest, 1.2 * largest)
    axes.set_yticks(ticks, [f"{tick:g}".replace("-", "\N{MINUS SIGN}") for tick in ticks])
    axes.yaxis.set_minor_locator(_no_ticks())
    _root_axis(axes, max(float(t.frame[-1]) for t in traces))


def _root_axis(axes: Axes, last: float) -> None:
    """Number frames along the root of their number."""
    axes.set_xscale("function", functions=(_root, np.square))
    axes.set_xlim(1.0, max(last, 2.0))
    wanted: list[float] = []
    for tick in (*_TICKS, last):
        far = not wanted or math.sqrt(tick) - math.sqrt(wanted[-1]) > 0.1 * math.sqrt(last)
        if tick <= last and far:
            wanted.append(tick)
    axes.set_xticks(wanted, [f"{tick:g}" for tick in wanted])


def _root(frame: Any) -> Any:
    return np.sqrt(np.maximum(frame, 0.0))


def _no_ticks() -> Any:
    from matplotlib.ticker import NullLocator

    return NullLocator()


def way_of_filter(document: Document, name: str) -> str | None:
    """NIS per arc with its expected level, matched stars, and where the baseline was in use."""
    found = section(document, "sequential")
    history = section(found, "history")
    data = columns(history, "nis_per_arc", "arcs", "noise_scale", "matched", "matched_baseline")
    if data is None:
        return None
    on_baseline = flags(history.get("on_baseline"))
    if len(on_baseline) != len(data[0]):
        on_baseline = np.zeros(len(data[0]), np.bool_)
    frame = _frames(len(data[0]), number(found.get("frames")))
    shown = slice(None, None, math.ceil(len(frame) / _MOST_FRAMES))
    frame, on_baseline = frame[shown], on_baseline[shown]
    data = tuple(column[shown] for column in data)
    title = "Innovations and matched stars over the frames"
    return draw(name, title, (8.4, 4.6), lambda f: _way(f, frame, data, on_baseline))


def _way(figure: Figure, frame: Floats, data: tuple[Floats, ...], on_baseline: Any) -> None:
    nis, arcs, scale, matched, baseline = data
    upper, lower, strip = figure.subplots(3, 1, sharex=True, height_ratios=(5, 4, 0.5))
    _nis(upper, frame, nis, arcs, scale)
    start_axes(lower, "Matched stars per frame", "", "stars")
    lower.plot(frame, baseline, "s", color=BEFORE, ms=2.6, mew=0, label="baseline")
    lower.plot(frame, matched, "o", color=AFTER, ms=2.6, mew=0, label="estimate")
    lower.set_ylim(bottom=min(0.0, lower.get_ylim()[0]))
    lower.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, markerscale=2.0)
    start_axes(strip, "", "frame", "", grid="")
    strip.fill_between(frame, 0.0, 1.0, where=on_baseline, color=BEFORE, step="mid", lw=0)
    strip.set_ylim(0.0, 1.0)
    strip.set_yticks([0.5], ["baseline in use"])
    strip.tick_params(axis="y", length=0)
    strip.set_xlim(0.0, 1.01 * float(frame[-1]) + 1.0)


def _nis(axes: Axes, frame: Floats, nis: Floats, arcs: Floats, scale: Floats) -> None:
    """NIS per arc: its level under the noise found, and where 95 % of the frames should lie."""
    start_axes(axes, "NIS per arc", "", "NIS / arcs")
    level = scale**2
    low, high = _interval_95(arcs)
    known = np.isfinite(level) & np.isfinite(high)
    top = 1.6 * float(np.max(level[known] * high[known], initial=1.0))
    with np.errstate(invalid="ignore"):
        beyond = nis > top
    axes.fill_between(frame, low * level, high * level, color=FAINT, alpha=0.55, lw=0,
                      label="95 % interval")  # fmt: skip
    axes.plot(frame, nis, ".", color=AFTER, ms=3.2, mew=0, label="frame")
    axes.plot(frame[beyond], np.full(beyond.sum(), 0.97 * top), "^", color=AFTER, ms=4, mew=0)
    axes.plot(frame, level, color="black", lw=1.0, label="expected, noise found so far")
    axes.axhline(1.0, color=NEUTRAL, lw=0.9, ls="--", label="expected, configured noise")
    axes.set_ylim(0.0, top)
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, handlelength=1.4)


def _interval_95(arcs: Floats) -> tuple[Floats, Floats]:
    """Return the 95 % interval of chi-square per degree of freedom (Wilson & Hilferty 1931).

    The typical frame's: one that changes with every frame can't be read.
    """
    used = arcs[arcs > 0]
    count = float(np.median(used)) if len(used) else math.nan
    width = 2.0 / (9.0 * count)
    low, high = ((1.0 - width + sign * _NORMAL_95 * math.sqrt(width)) ** 3 for sign in (-1, 1))
    return np.full(len(arcs), max(low, 0.0)), np.full(len(arcs), high)
