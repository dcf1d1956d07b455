"""Figures of the fit's report: parameters, correlation, singular values, cycles, as SVG text.

Each takes the document; None means that it holds nothing to draw.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from stcal.report.content import quotient
from stcal.report.document import Document, Floats, matrix, numbers, sections, sequence, text
from stcal.report.fit_content import is_held
from stcal.report.format import fixed, significant
from stcal.report.svg import AFTER, FAINT, NEUTRAL, draw, start_axes
from stcal.units import unit_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def parameter_changes(document: Document, name: str) -> str | None:
    """Bars of the change of each parameter in units of its spread from unit to unit."""
    listed = [p for p in sections(document.get("parameters")) if not is_held(p, document)]
    found = [p for p in listed if np.isfinite(numbers([p.get("change_sigma")])).all()]
    if not found:
        return None
    symbols = [unit_of(text(p.get("name"))).symbol for p in found]
    change = numbers([p.get("change_sigma") for p in found])
    ratio = [quotient(p.get("sd"), p.get("sigma")) for p in found]
    sd = np.abs(np.nan_to_num(numbers(ratio)))
    title = "Change of each parameter in sigma"
    size = (6.4, 1.0 + 0.3 * len(found))
    return draw(name, title, size, lambda f: _bars(f, symbols, change, sd))


def _bars(figure: Figure, symbols: list[str], change: Floats, sd: Floats) -> None:
    axes = figure.add_subplot()
    places = np.arange(len(change))
    start_axes(
        axes, "Change from the initial calibration", "change [sigma], bar ends ±1 sd", "", "x"
    )
    axes.barh(places, change, height=0.62, color=AFTER, alpha=0.85)
    axes.errorbar(change, places, xerr=sd, fmt="none", ecolor="black", elinewidth=1.0, capsize=2.5)
    axes.axvline(0.0, color=NEUTRAL, lw=0.8)
    for place, value, spread in zip(places, change, sd, strict=True):
        end = value + math.copysign(spread, value)
        axes.annotate(
            fixed(value, 2, signed=True), (end, place), xytext=(math.copysign(5, value), 0),
            textcoords="offset points", va="center", ha="left" if value >= 0 else "right",
            fontsize=8,
        )  # fmt: skip
    axes.set_yticks(places, symbols)
    axes.invert_yaxis()
    axes.margins(x=0.16)
    axes.tick_params(axis="y", length=0)


def correlations(document: Document, name: str) -> str | None:
    """Heat map of the correlation matrix, with its numbers."""
    symbols = _symbols(document)
    found = matrix(document.get("correlation"), len(symbols))
    if found is None or len(found) != len(symbols) or not 1 <= len(symbols) <= 16:
        return None
    side = 1.0 + 0.42 * len(symbols)
    title = "Correlation of the fitted parameters"
    return draw(name, title, (side, side), lambda f: _heat_map(f, found, symbols))


def _heat_map(figure: Figure, found: Floats, symbols: list[str]) -> None:
    axes = figure.add_subplot()
    edges = np.arange(len(symbols) + 1) - 0.5
    axes.pcolormesh(
        edges, edges, found, cmap="RdBu_r", vmin=-1, vmax=1, edgecolors="white", linewidth=1.0
    )
    for i, row in enumerate(found):
        for j, value in enumerate(row):
            colour = "white" if abs(value) > 0.62 else "#222222"
            label = "1" if i == j else fixed(value, 2)
            axes.text(j, i, label, ha="center", va="center", fontsize=7, color=colour)
    places = range(len(symbols))
    axes.set_xticks(places, symbols)
    axes.set_yticks(places, symbols)
    axes.set_aspect("equal")
    axes.invert_yaxis()
    axes.set_title("Correlation")
    axes.tick_params(length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)


def singular_values(document: Document, name: str) -> str | None:
    """Singular values of the scaled problem, each with its leading parameters."""
    values = numbers(document.get("singular_values"))
    if not len(values) or len(values) > 32 or not np.isfinite(values).all() or (values <= 0).any():
        return None
    vectors = matrix(document.get("singular_vectors"), len(values))
    labels = _directions(vectors, _symbols(document), len(values))
    condition = significant(float(values.max() / values.min()), 3)
    size = (5.2, 1.0 + 0.3 * len(values))
    title = "Singular values of the scaled problem"
    return draw(name, title, size, lambda f: _stems(f, values, labels, condition))


def _directions(vectors: Floats | None, symbols: list[str], count: int) -> list[str]:
    """Name each right singular vector (a column) by its two largest components."""
    if vectors is None or len(vectors) != len(symbols):
        return [str(k + 1) for k in range(count)]
    labels = []
    for column in vectors.T:
        leading = [k for k in np.argsort(-np.abs(column), kind="stable")[:2] if column[k]]
        if not leading:
            return [str(k + 1) for k in range(count)]
        sign = math.copysign(1.0, column[leading[0]])
        terms = [
            f"{fixed(sign * column[k], 2, signed=True)} {symbols[k]}"
            for k in leading
            if abs(column[k]) >= 0.005
        ]
        labels.append("  ".join(terms).removeprefix("+"))
    return labels


def _stems(figure: Figure, values: Floats, labels: list[str], condition: str) -> None:
    axes = figure.add_subplot()
    places = np.arange(len(values))
    heading = f"What the data determine: condition {condition}"
    start_axes(axes, heading, "singular value, scaled parameters [-]", "", "x")
    axes.set_xscale("log")
    left = 10.0 ** (math.floor(math.log10(values.min())) - 0.15)
    axes.hlines(places, left, values, color=FAINT, lw=2.5)
    axes.plot(values, places, "o", color=AFTER, ms=5)
    for place, value in zip(places, values, strict=True):
        label = fixed(value, 0) if value >= 100 else significant(value, 3)
        axes.annotate(
            label, (value, place), xytext=(6, 0), textcoords="offset points", va="center",
            fontsize=8,
        )  # fmt: skip
    axes.set_xlim(left, values.max() * 3.0)
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.minorticks_off()
    axes.set_yticks(places, labels)
    axes.invert_yaxis()
    axes.tick_params(axis="y", length=0)


def cycles(document: Document, name: str) -> str | None:
    """RMS and matched stars over the cycles of rematching."""
    rows = sections(document.get("cycles"))
    found = [
        numbers([row.get(key) for row in rows])
        for key in ("cycle", "rms_urad", "matched_stars", "matches_changed")
    ]
    if not rows or not np.isfinite(found[0]).any():
        return None
    return draw(name, "Cycles of rematching", (7.2, 2.6), lambda f: _cycle_panels(f, *found))


def _cycle_panels(
    figure: Figure, cycle: Floats, rms: Floats, matched: Floats, changed: Floats
) -> None:
    panels = figure.subplots(1, 3)
    lines = (
        (rms, "Residual RMS", "[µrad]"),
        (matched, "Matched stars", ""),
        (changed, "Matches changed", ""),
    )
    for axes, (values, heading, unit) in zip(panels, lines, strict=True):
        start_axes(axes, f"{heading} {unit}".strip(), "cycle", "")
        axes.plot(cycle, values, "o-", color=AFTER, ms=4)
        axes.set_xticks(np.unique(cycle[np.isfinite(cycle)])[:: max(1, len(cycle) // 8)])
        axes.margins(x=0.12, y=0.18)
        if np.isfinite(values).any() and axes.get_ylim()[0] < 0:
            axes.set_ylim(bottom=0)
        axes.ticklabel_format(axis="y", useOffset=False, style="plain")


def _symbols(document: Document) -> list[str]:
    """Return the symbols of the estimated parameters."""
    return [unit_of(text(name)).symbol for name in sequence(document.get("estimated_parameters"))]
