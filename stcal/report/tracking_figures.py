"""Figures of the study ``tracking``: truth and estimate over the frames, as SVG text.

Each takes a case of the document; None means that it holds nothing to draw.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from stcal.report.document import Document, Floats, columns, numbers, section
from stcal.report.svg import AFTER, BEFORE, FAINT, NEUTRAL, draw, start_axes
from stcal.report.tracking_content import VARIANTS
from stcal.units import unit_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's green beside the two colours of all reports.
_COLOURS = {"no_q": BEFORE, "thermal": "#009E73"}
_TRUTH: dict[str, Any] = {"color": "black", "lw": 1.0, "ls": (0, (4, 2)), "label": "truth"}
_SIZES = {"f_m": (1e-6, "µm")}
_WITHIN_SD = 3.0


@dataclass(frozen=True)
class Curve:
    """Truth and one variant's estimate of one parameter (N,), and its sd, in the unit shown."""

    x: Floats
    truth: Floats
    value: Floats
    sd: Floats


def drift(case: Document, name: str) -> str | None:
    """The focal length and three variants' estimates of it."""
    curves = _curves(case, "all", ("no_q", "q", "thermal"), "f_m", "time_h")
    title = "Focal length and its estimates over time"
    return _stack(name, title, curves, "change of f [µm]", against_truth=False)


def drift_errors(case: Document, name: str) -> str | None:
    """Errors of the focal length at a third, one and three times the process noise."""
    curves = _curves(case, "all", ("q_third", "q", "q_triple"), "f_m", "time_h")
    title = "Error of the focal length over time, by process noise"
    return _stack(name, title, curves, "error of f [µm]", against_truth=True)


def _curves(
    case: Document, which: str, variants: tuple[str, ...], parameter: str, x: str
) -> dict[str, Curve]:
    series = section(case, "series", which)
    size, _ = _size(parameter)
    found = {}
    for variant in variants:
        group = section(series, "variants", variant, parameter)
        truth = section(series, "truth").get(parameter)
        data = columns({"x": series.get(x), "truth": truth, **group}, "x", "truth", "value", "sd")
        if data is not None and all(np.isfinite(column).any() for column in data):
            place, *values = data
            found[variant] = Curve(place, *(value / size for value in values))
    return found


def _size(parameter: str) -> tuple[float, str]:
    unit = unit_of(parameter)
    return _SIZES.get(parameter, (unit.size, unit.shown))


def _stack(
    name: str, title: str, curves: dict[str, Curve], y: str, against_truth: bool
) -> str | None:
    if not curves:
        return None

    def plot(figure: Figure) -> None:
        panels = figure.subplots(len(curves), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for axes, (variant, curve) in zip(panels, curves.items(), strict=True):
            start_axes(axes, VARIANTS[variant], "", y)
            _band(axes, curve, _COLOURS.get(variant, AFTER), against_truth)
        panels[-1].set_xlabel("time since the first frame [h]")
        panels[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)

    return draw(name, title, (8.4, 0.6 + 1.7 * len(curves)), plot)


def _band(axes: Axes, curve: Curve, colour: str, against_truth: bool) -> None:
    """Draw an estimate (or its error) with its 3-sigma band and the truth."""
    gaps = _gaps(curve.x)
    x = np.insert(curve.x, gaps, np.nan)
    zero = curve.truth if against_truth else np.zeros(len(curve.x))
    value, truth = (np.insert(v - zero, gaps, np.nan) for v in (curve.value, curve.truth))
    bound = _WITHIN_SD * np.insert(curve.sd, gaps, np.nan)
    middle = np.zeros(len(value)) if against_truth else value
    axes.fill_between(
        x, middle - bound, middle + bound, color=colour, alpha=0.22, lw=0, label="3 sd"
    )
    axes.plot(x, value, color=colour, lw=1.1, label="error" if against_truth else "estimate")
    axes.plot(x, truth, **_TRUTH | ({"ls": "-", "lw": 0.7} if against_truth else {}))
    reach = [v[np.isfinite(v)] for v in (curve.value - zero, curve.truth - zero)]
    _reach(axes, np.concatenate(reach))


def _reach(axes: Axes, values: Floats) -> None:
    """Show nearly all values: the first frames would fill any range."""
    low, high = np.percentile(values, [1.0, 99.0])
    margin = 0.35 * float(high - low) or 1.0
    shown = axes.get_ylim() if axes.get_autoscaley_on() is False else (low - margin, high + margin)
    axes.set_ylim(min(shown[0], low - margin), max(shown[1], high + margin))


def _gaps(x: Floats) -> Any:
    """Return where neighbouring frames lie far apart: no line joins them."""
    steps = np.diff(x)
    usual = float(np.nanmedian(steps)) if len(steps) else 0.0
    with np.errstate(invalid="ignore"):
        return np.flatnonzero(steps > 5.0 * max(usual, 1e-9)) + 1


def principal_point(case: Document, name: str) -> str | None:
    """Errors of the principal point without and with process noise of the focal length."""
    found = {p: _curves(case, "all", ("no_q", "q"), p, "time_h") for p in ("m0_px", "n0_px")}
    if not any(found.values()):
        return None
    title = "Errors of the principal point over time"
    return draw(name, title, (8.4, 4.2), lambda f: _grid(f, found))


def _grid(figure: Figure, found: dict[str, dict[str, Curve]]) -> None:
    panels = figure.subplots(2, 2, sharex=True, squeeze=False)
    for row, (parameter, curves) in zip(panels, found.items(), strict=True):
        symbol = unit_of(parameter).symbol
        for axes, variant in zip(row, ("no_q", "q"), strict=True):
            start_axes(axes, f"{symbol}, {VARIANTS[variant]}", "", f"error of {symbol} [px]")
            if variant in curves:
                _band(axes, curves[variant], _COLOURS.get(variant, AFTER), against_truth=True)
    for axes in panels[-1]:
        axes.set_xlabel("time since the first frame [h]")


def step(case: Document, name: str) -> str | None:
    """Focal length and principal point before and after the step, with and without Q."""
    found = {
        (p, which): _curves(case, which, ("no_q", "q"), p, "frame")
        for p in ("f_m", "m0_px")
        for which in ("all", "around_step")
    }
    if not any(found.values()):
        return None
    title = "Focal length and principal point around the step"
    return draw(name, title, (9.6, 4.6), lambda f: _step_panels(f, found))


def _step_panels(figure: Figure, found: dict[tuple[str, str], dict[str, Curve]]) -> None:
    panels = figure.subplots(2, 2, sharex="col", squeeze=False)
    for axes, ((parameter, which), curves) in zip(panels.flat, found.items(), strict=True):
        symbol, unit = unit_of(parameter).symbol, _size(parameter)[1]
        heading = {"all": "all frames", "around_step": "around the step"}[which]
        start_axes(axes, f"{symbol}, {heading}", "", f"change of {symbol} [{unit}]")
        for variant, curve in curves.items():
            colour, bound = _COLOURS.get(variant, AFTER), _WITHIN_SD * curve.sd
            low, high = curve.value - bound, curve.value + bound
            axes.fill_between(curve.x, low, high, color=colour, alpha=0.2, lw=0)
            axes.plot(curve.x, curve.value, color=colour, lw=1.1, label=VARIANTS[variant])
        for curve in list(curves.values())[:1]:
            axes.plot(curve.x, curve.truth, **_TRUTH, drawstyle="steps-post")
        values = [v for c in curves.values() for v in (c.value, c.truth)]
        known = np.concatenate([v[np.isfinite(v)] for v in values]) if values else np.empty(0)
        if len(known):
            _reach(axes, known)
    for axes in panels[-1]:
        axes.set_xlabel("frame")
    panels[0, 1].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)


def errors(case: Document, name: str) -> str | None:
    """RMS arclength error over the frames, of each variant and of the true camera."""
    blocks = section(case, "blocks")
    x = numbers(blocks.get("frame"))
    shown = {key: numbers(blocks.get(key)) for key in ("no_q", "q", "q_all", "thermal", "true")}
    curves = {
        key: values
        for key, values in shown.items()
        if len(values) == len(x) and np.isfinite(values).any()
    }
    if not len(x) or not curves:
        return None
    title = "RMS arclength error over the frames"
    return draw(name, title, (8.4, 2.9), lambda f: _error_panel(f, x, curves))


def _error_panel(figure: Figure, x: Floats, curves: dict[str, Floats]) -> None:
    axes = figure.add_subplot()
    start_axes(axes, "RMS arclength error", "frame", "RMS [µrad]")
    styles: dict[str, dict[str, Any]] = {
        "true": {"color": "black", "lw": 1.0, "ls": (0, (4, 2)), "label": "true camera"},
        "q_all": {"color": NEUTRAL, "lw": 0.9},
    }
    for key, values in curves.items():
        style: dict[str, Any] = {"color": _COLOURS.get(key, AFTER), "lw": 1.2}
        style |= {"label": VARIANTS.get(key, key)} | styles.get(key, {})
        axes.plot(x, values, **style)
    settled = np.concatenate([values[1:] for values in curves.values()])
    settled = settled[np.isfinite(settled)]
    if len(settled):
        axes.set_ylim(0.0, 1.1 * float(settled.max()) or 1.0)
    axes.axhline(0.0, color=FAINT, lw=0.6)
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=5)
