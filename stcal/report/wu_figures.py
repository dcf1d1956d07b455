"""Figures 3, 4 and 6 of the study ``wu`` as SVG text.

Each takes the document; None means that it holds nothing to draw.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from stcal.report.document import Document, Floats, numbers, section
from stcal.report.svg import (
    AFTER,
    BEFORE,
    NEUTRAL,
    draw,
    plain_numbers,
    start_axes,
)
from stcal.report.wu_content import LABELS, TESTED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's green and purple beside the two colours of all reports.
_GREEN, _PURPLE = "#009E73", "#CC79A7"
_MODELS: dict[str, dict[str, Any]] = {
    "1": {"color": BEFORE, "marker": "o"},
    "2": {"color": _GREEN, "marker": "s"},
    "3": {"color": _PURPLE, "marker": "^"},
    "4": {"color": AFTER, "marker": "D"},
}
_VALUES: dict[str, dict[str, Any]] = {
    "1": {"color": BEFORE, "marker": "o"},
    "2": {"color": AFTER, "marker": "s"},
    "3": {"color": _GREEN, "marker": "^"},
}
_METHODS: dict[str, dict[str, Any]] = {
    "ad": {"color": AFTER, "lw": 2.0},
    "svd": {"color": BEFORE, "lw": 1.1},
}


def observability(document: Document, name: str) -> str | None:
    """Figures 3 and 4: smallest singular value of the scaled observability matrix by image."""
    found = section(document, "observability")
    panels = (
        ("Models, {σ2,σ3}", "model", _positive(section(found, "models"), _MODELS)),
        ("Singular values, model 4", "σ", _positive(section(found, "values"), _VALUES)),
    )
    if not any(series for *_, series in panels):
        return None
    title = "Smallest singular value of the observability matrix by image"
    return draw(name, title, (9.6, 3.4), lambda f: _observability_panels(f, panels))


def _positive(group: Document, styles: dict[str, dict[str, Any]]) -> dict[str, Floats]:
    """Return series that a logarithmic axis can show: what isn't above zero is left out."""
    series = {}
    for key in styles:
        values = numbers(group.get(key))
        values[~(values > 0.0)] = np.nan
        if np.isfinite(values).any():
            series[key] = values
    return series


def _observability_panels(
    figure: Figure, panels: tuple[tuple[str, str, dict[str, Floats]], ...]
) -> None:
    for axes, (heading, label, series) in zip(figure.subplots(1, 2), panels, strict=True):
        start_axes(axes, heading, "image", "smallest singular value")
        styles = _MODELS if label == "model" else _VALUES
        for key, values in series.items():
            named = f"{label} {key}" if label == "model" else f"{label}{key}"
            image = np.arange(1, len(values) + 1)
            axes.plot(image, values, label=named, ls="none", ms=2.2, **styles[key])
        if series:
            axes.set_yscale("log")
            plain_numbers(axes.yaxis)
            _legend(axes)


def convergence(document: Document, name: str) -> str | None:
    """Figure 6: both criteria with the estimate after each image, AD and SVD."""
    found = section(document, "groups", TESTED, "convergence")
    image = numbers(found.get("image"))
    panels = {key: _curves(section(found, key), image) for key in ("a", "b")}
    if not any(panels.values()):
        return None
    bound = numbers(found.get("bound"))
    title = "Errors of angular distances over images"
    return draw(name, title, (9.6, 3.5), lambda f: _convergence_panels(f, image, panels, bound))


def _curves(group: Document, image: Floats) -> dict[str, Floats]:
    curves = {key: numbers(group.get(key)) for key in _METHODS}
    return {
        key: values
        for key, values in curves.items()
        if len(values) == len(image) and (values > 0.0).any()
    }


def _convergence_panels(
    figure: Figure, image: Floats, panels: dict[str, dict[str, Floats]], bound: Floats
) -> None:
    headings = {"a": "a) Criterion A: true centroids", "b": "b) Criterion B: measured centroids"}
    for axes, (key, curves) in zip(figure.subplots(1, 2), panels.items(), strict=True):
        start_axes(axes, headings[key], "image", "RMSE [arcsec]")
        for method, values in curves.items():
            axes.plot(image, values, label=LABELS[method], **_METHODS[method])
        if key == "a" and len(bound) == len(image):
            axes.plot(image, bound, label="bound", color=NEUTRAL, ls=":", lw=1.4)
        axes.set_xscale("log")
        plain_numbers(axes.xaxis)
        if curves and key == "a":
            axes.set_yscale("log")
            plain_numbers(axes.yaxis)
        if curves:
            _legend(axes)


def _legend(axes: Axes) -> None:
    axes.legend(loc="best", handlelength=2.4, ncols=2)
