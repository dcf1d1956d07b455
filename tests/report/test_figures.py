from __future__ import annotations

import copy
import re
from typing import Any

import numpy as np
import pytest
from sample_documents import fit_document

from stcal.report import figures, fit_figures

LABELS = ("initial", "fitted")


def texts(svg: str | None) -> list[str]:
    assert svg is not None
    return re.findall(r"<text[^>]*>([^<]*)</text>", svg)


def drawn() -> dict[str, str | None]:
    document = fit_document(300)
    return {
        "before": figures.residual_field(document["field"], "before", "initial", "a"),
        "after": figures.residual_field(document["field"], "after", "fitted", "b"),
        "radial": figures.radial_profile(document["radial"], LABELS, "c"),
        "changes": fit_figures.parameter_changes(document, "d"),
        "correlation": fit_figures.correlations(document, "e"),
        "singular": fit_figures.singular_values(document, "f"),
        "cycles": fit_figures.cycles(document, "g"),
        "series": figures.matched_over_time(document["series"], LABELS, "h"),
    }


def test_every_figure_is_small_and_names_its_axes() -> None:
    labels = {
        "before": ["column n [px]", "row m [px]"],
        "after": ["column n [px]", "row m [px]"],
        "radial": ["distance from the centre [px]", "mean, outwards [px]"],
        "changes": ["change [sigma], bar ends ±1 sd", "b4"],
        "correlation": ["m0", "g_y"],
        "singular": ["singular value, scaled parameters [-]"],
        "cycles": ["cycle", "Residual RMS [µrad]"],
        "series": ["stars", "time [UTC]"],
    }
    for name, svg in drawn().items():
        assert svg is not None, name
        assert len(svg) < 150_000, name
        assert set(labels[name]) <= set(texts(svg)), name
        assert "<title>" in svg


def one_cell(row: float, col: float) -> dict[str, Any]:
    cells = {"row_px": [500.0, 1500.0], "col_px": [600.0, 2000.0], "count": [50, 50]}
    vectors = {f"{w}_{a}_px": [v, v] for w in ("before", "after") for a, v in zip(("row", "col"), (row, col), strict=True)}  # fmt: skip  # noqa: E501
    return {**cells, **vectors, "rows": 1944, "cols": 2592}


def test_field_title_and_key_tell_the_size() -> None:
    svg = figures.residual_field(one_cell(3.0, 4.0), "before", "initial", "n")
    assert "Initial: RMS 5 px" in texts(svg)
    assert "5 px" in texts(svg)
    svg = figures.residual_field(one_cell(0.0, 0.03), "after", "fitted", "n")
    assert "Fitted: RMS 0.03 px" in texts(svg)
    assert "0.02 px" in texts(svg)


def arrow_span(svg: str | None) -> tuple[float, float]:
    """Extent in x and y of the first arrow's outline."""
    assert svg is not None
    fill = figures.BEFORE.lower()
    path = re.search(rf'<path d="([^"]*)"[^>]*style="fill: {fill}', svg) or re.search(
        rf'style="fill: {fill}[^>]*>\s*<path d="([^"]*)"|<path d="([^"]*)"[^>]*{fill}', svg
    )
    assert path is not None
    outline = next(group for group in path.groups() if group)
    points = np.array(re.findall(r"[ML] ?([-\d.]+) ([-\d.]+)", outline), dtype=float)
    x, y = np.ptp(points, axis=0)
    return float(x), float(y)


def test_column_residuals_point_along_x_and_row_residuals_along_y() -> None:
    x, y = arrow_span(figures.residual_field(one_cell(0.0, 1.0), "before", "initial", "n"))
    assert x > 3 * y
    x, y = arrow_span(figures.residual_field(one_cell(1.0, 0.0), "before", "initial", "n"))
    assert y > 3 * x


def test_key_is_never_longer_than_the_largest_arrow() -> None:
    for largest in (0.0123, 0.1, 0.99999, 1.0, 2.0, 4.9, 5.0, 73.0):
        key = figures._round_length(largest)
        assert 0.39 * largest < key <= largest * (1 + 1e-9)


def test_few_stars_are_faint() -> None:
    field = one_cell(1.0, 1.0)
    field["count"] = [1, 50]
    svg = figures.residual_field(field, "before", "initial", "n")
    assert svg is not None
    assert figures.FAINT.lower() in svg


def test_no_fix_share_and_ticks() -> None:
    series = {
        "time_utc": [f"2026-01-05T00:0{k}:00.000Z" for k in range(4)],
        "matched_initial": [5, 0, 7, None],
        "matched_fitted": [9, 9, 9, 9],
        "fix_initial": [True, False, True, False],
        "fix_fitted": [True] * 4,
    }
    svg = figures.matched_over_time(series, LABELS, "n")
    assert "initial 50.0 %" in texts(svg)
    assert "fitted 0.0 %" in texts(svg)
    assert "Matched stars per frame" in texts(svg)
    assert ticks(svg, figures.BEFORE) == 2
    assert ticks(svg, figures.AFTER) == 0


def ticks(svg: str | None, colour: str) -> int:
    """Number of no-fix ticks: the one path that has the ticks' width."""
    assert svg is not None
    paths = re.findall(r'<path d="([^"]*)"[^>]*style="([^"]*)"', svg)
    drawn = [d for d, s in paths if f"stroke: {colour.lower()}; stroke-width: 0.9" in s]
    return sum(d.count("M") for d in drawn)


def test_long_series_are_averaged_without_losing_the_mean() -> None:
    x = np.linspace(0.0, 10.0, 100_000)
    values = np.sin(x) + 5.0
    values[::7] = np.nan
    at, mean = figures._thinned(x, values)
    assert len(at) <= 300
    assert np.abs(mean - (np.sin(at) + 5.0)).max() < 1e-3


@pytest.mark.parametrize("bad", ["2026-13-05T00:00:00Z", "yesterday", "", None])
def test_unreadable_times_are_not_drawn(bad: str | None) -> None:
    series = copy.deepcopy(fit_document(5)["series"])
    series["time_utc"][2] = bad
    assert figures.matched_over_time(series, LABELS, "n") is None


def test_columns_of_unequal_length_are_not_drawn() -> None:
    document = fit_document(5)
    document["field"]["row_px"].pop()
    document["radial"]["before_px"].pop()
    document["series"]["fix_initial"].pop()
    document["correlation"].pop()
    assert figures.residual_field(document["field"], "before", "initial", "n") is None
    assert figures.radial_profile(document["radial"], LABELS, "n") is None
    assert figures.matched_over_time(document["series"], LABELS, "n") is None
    assert fit_figures.correlations(document, "n") is None


def test_correlation_shows_its_numbers() -> None:
    document = fit_document()
    shown = texts(fit_figures.correlations(document, "n"))
    value = document["correlation"][0][4]
    assert shown.count(f"{value:.2f}".replace("-", "−")) >= 2


def test_singular_directions_name_their_leading_parameters() -> None:
    document = fit_document()
    vectors = np.eye(8)
    vectors[[1, 6, 7], 7] = (-0.8, -0.6, 0.0)
    document["singular_vectors"] = vectors.tolist()
    shown = texts(fit_figures.singular_values(document, "n"))
    assert "0.80 m0  +0.60 a2" in shown
    assert "1.00 f" in shown


def test_bars_print_the_change() -> None:
    shown = texts(fit_figures.parameter_changes(fit_document(), "n"))
    assert {"−1.61", "+1.35", "−1.16", "+0.81"} <= set(shown)


def test_radial_whiskers_are_the_sd_of_the_mean(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Any] = []
    monkeypatch.setattr(figures, "_profiles", lambda *arguments: seen.append(arguments[2]))
    profile = {
        "radius_px": [100.0, 200.0],
        "before_px": [1.0, 1.0],
        "after_px": [0.0, None],
        "sd_after_px": [0.4, None],
        "count": [16, 0],
    }
    figures.radial_profile(profile, LABELS, "n")
    figures.radial_profile({**profile, "count": []}, LABELS, "n")
    assert [sd.tolist() for sd in seen] == [[0.1, 0.0], [0.0, 0.0]]
