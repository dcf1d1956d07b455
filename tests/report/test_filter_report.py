"""What the report of a sequential fit shows of its filter."""

from __future__ import annotations

import io
import re
import warnings
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from sample_documents import fit_document, hollow, sequential_document
from test_html import Page

from stcal.report import filter_content, filter_figures
from stcal.report.fit_figures import parameter_changes
from stcal.report.html import render_fit
from stcal.report.tables import fit_tables


def printed(document: Any, width: int = 80) -> str:
    stream = io.StringIO()
    fit_tables(document, Console(file=stream, width=width, color_system=None))
    return stream.getvalue()


def texts(svg: str | None) -> list[str]:
    assert svg is not None
    return re.findall(r"<text[^>]*>([^<]*)</text>", svg)


def test_report_shows_the_filter_instead_of_cycles() -> None:
    page = Page(render_fit(sequential_document()))
    assert page.count("svg") == 9
    assert "not available" not in page.body
    assert not {"Cycles", "Matches of the first cycle", "Matched set settled"} & set(page.body)
    for shown in (
        "sqrf, double precision",
        "the estimate before each frame",
        "f 0.5; m0, n0 0.1 sigma per √h",
        "120 / 117",
        "1.495 / 1.002",
        "94.8 %",
        "−0.008",
        "0.14 sd",
        "81.0 % / 99.0 % / 96.7 %",
        "1\u202f320 / 2\u202f400",
        "yes; 1 fallback",
        "the estimate",
    ):
        assert shown in page.body, shown
    assert {"Fallbacks", "37", "fewer stars matched"} <= set(page.body)
    assert "linear in temperature: chosen" in page.body
    assert "412.3 (more than 10.0 needed)" in page.body
    assert "+0.0020027 ± 0.0000078 mm/K" in page.body
    assert "12.0 to 28.0 °C" in page.body


def test_a_batch_fit_has_no_filter() -> None:
    page = Page(render_fit(fit_document()))
    assert "Cycles" in page.body
    assert not {"The filter", "Convergence"} & set(page.body)


def test_terminal_shows_the_same_in_80_columns() -> None:
    text = printed(sequential_document())
    assert "…" not in text
    assert "Cycles" not in text
    for shown in ("1.495 / 1.002", "fewer stars matched", "linear in temperature: chosen"):
        assert shown in text


def test_quiet_run_has_neither_fallbacks_nor_temperature() -> None:
    document = sequential_document()
    document["sequential"] |= {"events": [], "temperature": None}
    tables = filter_content.filter_tables(document)
    assert [table.title for table in tables] == ["The filter"]
    assert ("Falls back to the baseline", "yes; no fallbacks") in tables[0].rows


@pytest.mark.parametrize(
    ("noise", "shown"),
    [
        ({}, "none"),
        (None, "none"),
        ({"f_m": 0.0, "g_y": 0.0}, "none"),
        ({"f_m": 0.05, "a1_rad": 0.05, "g_y": 0.05}, "0.05 sigma per √h, each parameter"),
        ({"f_m": 3.0, "m0_px": 3.0}, "f 3 sigma per √h"),
        ({"f_m": 3.0, "a1_rad": 1.0, "g_y": 1.0}, "f 3; a1, g_y 1 sigma per √h"),
    ],
)
def test_process_noise_in_words(noise: Any, shown: str) -> None:
    estimated = ["f_m", "a1_rad", "g_y"]
    assert filter_content.process_noise({"process_noise": noise}, estimated) == shown


def test_not_chosen_and_on_probation() -> None:
    document = sequential_document()
    document["sequential"] |= {"on_baseline": True}
    document["sequential"]["variant"]["rematch"] = False
    document["sequential"]["temperature"]["chosen"] = False
    page = Page(render_fit(document))
    assert "the baseline (on probation)" in page.body
    assert "the baseline only (no rematching)" in page.body
    assert "linear in temperature: not supported" in page.body


def test_many_fallbacks_are_counted_not_listed() -> None:
    document = sequential_document()
    document["sequential"]["events"] *= 400
    table = filter_content.fallback_table(document["sequential"])
    assert len(table.rows) == 30
    assert table.note.startswith("The first 30 of 400.")


def test_held_parameters_read_held() -> None:
    document = sequential_document()
    document["estimated_parameters"] = ["f_m", "m0_px", "n0_px"]
    for row in document["parameters"][3:]:
        row |= {"fitted": row["initial"], "sd": None, "change": 0.0, "change_sigma": 0.0,
                "change_sd": None}  # fmt: skip
    page = Page(render_fit(document))
    assert page.body.count("held") == 5
    start = page.body.index("b4 [10⁸ m⁻⁴]")
    assert page.body[start + 1 : start + 7] == ["0", "0", "held", "–", "–", "–"]
    assert "held" in printed(document)
    # An estimated one without sd is not held.
    document["parameters"][0]["sd"] = None
    assert Page(render_fit(document)).body.count("held") == 5


def test_bars_leave_held_parameters_out() -> None:
    document = fit_document()
    document["estimated_parameters"] = ["f_m"]
    for row in document["parameters"][1:]:
        row |= {"sd": None}
    shown = texts(parameter_changes(document, "n"))
    assert "f" in shown
    assert not {"m0", "g_y"} & set(shown)


def test_convergence_is_in_units_of_the_last_sd(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Any] = []
    monkeypatch.setattr(filter_figures, "_convergence", lambda *arguments: seen.append(arguments))
    document = sequential_document()
    history = document["sequential"]["history"]
    history["parameters"] = {"f_m": {"value": [3e-6, 1e-6, 2e-6], "sd": [8e-7, 4e-7, 2e-7]}}
    document["sequential"]["frames"] = 5
    filter_figures.convergence(document, "n")
    (trace,) = seen[0][1]
    np.testing.assert_allclose(trace.departure, [5.0, -5.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(trace.sd, [4.0, 2.0, 1.0])
    np.testing.assert_allclose(trace.frame, [1.0, 3.0, 5.0])
    assert trace.label == "f: 0.00200 ± 0.00020 mm"


def test_convergence_band_is_three_sd(monkeypatch: pytest.MonkeyPatch) -> None:
    bands: list[Any] = []

    def seen(_: Any, x: Any, low: Any, high: Any, **others: Any) -> None:
        bands.append((low, high))

    monkeypatch.setattr("matplotlib.axes.Axes.fill_between", seen)
    document = sequential_document()
    history = document["sequential"]["history"]
    history["parameters"] = {"f_m": {"value": [3e-6, 2e-6], "sd": [4e-7, 2e-7]}}
    filter_figures.convergence(document, "n")
    np.testing.assert_allclose(bands[0], [[-6.0, -3.0], [6.0, 3.0]])


def test_convergence_names_every_parameter() -> None:
    shown = texts(filter_figures.convergence(sequential_document(), "n"))
    for symbol in ("f: ", "m0: ", "b4: ", "g_y: "):
        assert any(label.startswith(symbol) for label in shown), symbol
    assert "departure [sd]" in shown


def test_nis_band_is_chi_square() -> None:
    from scipy.stats import chi2

    low, high = filter_figures._interval_95(np.array([0.0, 40.0, 40.0, 40.0]))
    np.testing.assert_allclose(low, chi2.ppf(0.025, 40) / 40, rtol=1e-3)
    np.testing.assert_allclose(high, chi2.ppf(0.975, 40) / 40, rtol=1e-3)


def test_baseline_in_use_is_marked() -> None:
    document = sequential_document()
    with_baseline = filter_figures.way_of_filter(document, "n")
    document["sequential"]["history"]["on_baseline"] = [False] * 120
    without = filter_figures.way_of_filter(document, "n")
    assert filled(with_baseline) == filled(without) + 1


def filled(svg: str | None) -> int:
    """Number of groups or areas in the baseline's colour."""
    assert svg is not None
    return svg.count(f"fill: {filter_figures.BEFORE.lower()}")


def test_hollow_and_junk_still_render() -> None:
    document = sequential_document(9)
    page = Page(render_fit(hollow(document)))
    assert page.count("svg") == 0
    assert "The filter" in page.body
    assert "None" not in page.body
    assert "nan" not in " ".join(page.body).lower().split()
    found, rest = document["sequential"], hollow(document)
    for junk in (None, "text", 3, True, [1, "x", None], {"a": [{}]}, [[[]]], -1e308):
        for key in found:
            # Figures take most of the time, and of these they know only the number of frames.
            drawn = {} if key == "frames" else {"history": None}
            Page(render_fit(rest | {"sequential": found | drawn | {key: junk}}))
        history = dict.fromkeys(found["history"], junk)
        Page(render_fit(rest | {"sequential": found | {"history": history}}))
        inner = {k: dict.fromkeys(v, junk) for k, v in found.items() if isinstance(v, dict)}
        Page(render_fit(rest | {"sequential": found | inner}))
        events = [dict.fromkeys(("frame_id", "time_utc", "event"), junk)]
        printed(document | {"sequential": found | inner | {"events": events}})


@pytest.mark.parametrize("size", [1e300, -1.7e308, 1e12, 5e-324])
def test_extreme_numbers_render_without_warnings(size: float) -> None:
    document = sequential_document(20)
    scaled = _scaled(document["sequential"], size)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert "<svg" in render_fit(document | {"sequential": scaled})


def _scaled(value: Any, size: float) -> Any:
    if isinstance(value, dict):
        return {key: _scaled(item, size) for key, item in value.items()}
    if isinstance(value, list):
        return [_scaled(item, size) for item in value]
    if isinstance(value, int | float) and not isinstance(value, bool):
        return size if value >= 0 else -size
    return value


def test_long_runs_stay_small() -> None:
    long, short = (len(render_fit(sequential_document(frames))) for frames in (50_000, 600))
    assert long < 1.1 * short
    many = sequential_document(600)
    history = many["sequential"]["history"]
    for key in ("nis_per_arc", "arcs", "noise_scale", "matched", "matched_baseline"):
        history[key] = history[key] * 100
    assert len(render_fit(many)) < 1.1 * short
