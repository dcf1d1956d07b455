"""The report of the study ``wu``: made of its document alone, whatever that holds."""

from __future__ import annotations

import copy
import io
import json
import re
import warnings
from typing import Any

import numpy as np
import pytest
from conftest import ROOT
from rich.console import Console
from sample_documents import hollow

from stcal.config import load_config
from stcal.report import wu_comparison_content as beyond
from stcal.report import wu_content as content
from stcal.report import wu_figures as figures
from stcal.report.content import Table
from stcal.report.html import RENDERERS
from stcal.report.study_content import findings
from stcal.report.wu_html import render, study_tables
from stcal.studies.wu import run_study

ATTACK = "</script><b>x</b>"


@pytest.fixture(scope="module")
def study() -> dict[str, Any]:
    """The document of one run, which stands for two that differ."""
    document = run_study(load_config(ROOT / "configs" / "wu2019.toml"), 1, 1, images=200)
    return _twice(json.loads(json.dumps(document))) | {"runs": 2}


def _twice(value: Any) -> Any:
    """Return the document with a second run of twice the numbers in every list over runs."""
    if isinstance(value, dict):
        return {key: _twice(item) for key, item in value.items()}
    if isinstance(value, list) and len(value) == 1:
        return [value[0], 2.0 * value[0]]
    return value


def rows(table: Table) -> dict[str, tuple[str, ...]]:
    return {row[0]: row[1:] for row in table.rows}


def columns(table: Table) -> dict[str, dict[str, str]]:
    return {
        heading: {row[0]: row[k + 1] for row in table.rows}
        for k, heading in enumerate(table.header[1:])
    }


def test_published_values_stand_above_ours(study: dict[str, Any]) -> None:
    models = rows(content.model_table(study))
    assert models["Δk2 [%], paper"] == ("−47.40", "+32.70", "+15.74", "+25.05")
    assert models['A mean ["], paper'] == ("0.852", "1.106", "4.392", "0.465")
    values = columns(content.value_table(study))
    assert list(values)[:3] == ["{σ1,σ2,σ3}", "{σ2,σ3}", "{σ1,σ2}"]
    assert values["{σ2}"]['A mean ["], paper'] == "0.384"
    assert values["{σ1,σ2,σ3}"]["Time [µs / image], paper"] == "8280"
    groups = columns(content.group_table(study))
    assert groups["1, AD"]['A sd ["], paper'] == "0.293"
    assert groups["3, SVD"]['B mean ["], paper'] == "10.612"


def test_ours_are_means_over_runs_with_their_spread(study: dict[str, Any]) -> None:
    group = columns(content.group_table(study))["1, SVD"]
    runs = np.array(study["groups"]["1"]["methods"]["svd"]["a"]["mean"])
    assert group['A mean ["], stcal'] == f"{runs.mean():.3f}"
    assert group['A mean ["], sd over runs'] == f"{runs.std():.3f}"
    bound = study["groups"]["1"]["bound"]
    assert group['A mean ["], bound'] == f"{bound['mean']:.3f}"
    low, high = bound["percentiles"][5], bound["percentiles"][95]
    shown = next(iter(rows(beyond.bound_table(study)).values()))[0]
    assert shown == f"{bound['mean']:.3f} ({low:.2f} to {high:.2f})"
    document = copy.deepcopy(study)
    document["groups"]["1"]["methods"]["svd"]["us_settled"] = 123.45
    shown = columns(content.group_table(document))["1, SVD"]
    assert shown["Time [µs / image], stcal"] == "123.5"
    errors = np.array(study["groups"]["2"]["methods"]["model 2"]["error_percent"]["f_m"])
    cell = columns(content.model_table(study))["Model 2"]["Δf [%], stcal"]
    assert cell == f"{errors.mean():+.4f} ± {errors.std():.4f}".replace("-", "−")


def test_a_single_run_has_no_spread() -> None:
    assert content.over_runs([0.25], 3) == "0.250"
    assert content.over_runs([0.25, None], 3) == "0.250"
    assert content.over_runs([], 3) == "not available"


def test_who_wins_is_read_from_the_document(study: dict[str, Any]) -> None:
    document = copy.deepcopy(study)
    found = rows(beyond.win_table(document))
    assert len(found) == 12
    assert {cells[2] for cells in found.values()} <= {"AD", "SVD", "neither"}
    document["comparison"]["wins"][0]["winner"] = "svd"
    assert rows(beyond.win_table(document))["accuracy, group 1"][2] == "SVD"


def test_what_the_published_numbers_imply(study: dict[str, Any]) -> None:
    found = rows(beyond.published_table(study))
    implied = study["comparison"]["published"]["3"]
    item = implied["svd"]
    assert found["3, SVD"] == (
        f"{item['over_bound']:.2f}",
        f"{item['over_bound_at_noise']:.2f}",
        f"{100 * item['luck']:.1f} %",
        f"{implied['noise_px']:.3f}",
    )
    settings = rows(beyond.settings_table(study))
    assert settings["f [mm]"][0].startswith("true 16, initial 15.5, ")
    assert "(paper 31.4)" in settings["Limiting magnitude, group 1"][0]


def texts(svg: str | None) -> list[str]:
    assert svg is not None
    assert len(svg) < 250_000
    return re.findall(r"<text[^>]*>([^<]*)</text>", svg)


def test_figures_are_drawn_with_every_curve(study: dict[str, Any]) -> None:
    observed = set(texts(figures.observability(study, "a")))
    assert {"model 1", "model 2", "model 4", "σ1", "σ2", "σ3"} <= observed
    # What is zero has no place on a logarithmic scale.
    assert "model 3" not in observed
    converged = set(texts(figures.convergence(study, "b")))
    assert {"AD", "SVD", "bound", "RMSE [arcsec]"} <= converged
    # Logarithmic scales have plain numbers.
    assert not any("mathdefault" in text for text in observed | converged)


@pytest.mark.parametrize("draw", [figures.observability, figures.convergence])
def test_a_figure_without_data_is_none(draw: Any, study: dict[str, Any]) -> None:
    assert draw({}, "n") is None
    assert draw(hollow(study), "n") is None


def test_the_page_shows_findings_tables_and_figures(study: dict[str, Any]) -> None:
    html = render(study)
    assert RENDERERS[study["schema"]](study) == html
    assert html.count('<div class="finding"') == 15
    assert html.count("<svg ") == 2
    for heading in ("Table 2", "Table 3", "Table 4", "Figures 3 and 4", "Figure 6"):
        assert f"<h3>{heading}. " in html
    assert "Of 15 statements, five of this study and ten of the paper, " in html
    assert "not available" not in html.replace(findings(study)[0].why, "")


def test_nothing_from_outside_and_everything_escaped(study: dict[str, Any]) -> None:
    html = render(_replaced(study, ATTACK, str))
    assert ATTACK not in html
    assert "&lt;/script&gt;" in html
    assert "http" not in html
    assert "src=" not in html
    identifiers = re.findall(r'\sid="([^"]+)"', html)
    assert len(identifiers) == len(set(identifiers))
    assert set(re.findall(r'(?:href="#|url\(#)([^")]+)', html)) <= set(identifiers)


def _replaced(value: Any, new: object, kinds: Any) -> Any:
    if isinstance(value, dict):
        return {key: _replaced(item, new, kinds) for key, item in value.items()}
    if isinstance(value, list):
        return [_replaced(item, new, kinds) for item in value]
    return new if isinstance(value, kinds) else value


def test_hollow_documents_make_a_report(study: dict[str, Any]) -> None:
    schema = {"schema": study["schema"]}
    emptied = copy.deepcopy(study) | {"groups": {"2": []}, "comparison": {"wins": [3, None, {}]}}
    for document in (hollow(study), emptied, schema, schema | {"groups": [], "paper": 3}):
        assert "not available" in render(document)
        printed(document)


@pytest.mark.parametrize("number", [0, 1e12, 5e-324, 1e300, -1.0, True, "text"])
def test_any_numbers_make_a_report_without_warnings(number: object, study: dict[str, Any]) -> None:
    document = _replaced(study, number, int | float)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert "<h1>" in render(document)
        printed(document)


def printed(document: dict[str, Any]) -> str:
    stream = io.StringIO()
    study_tables(document, Console(file=stream, width=80, color_system=None))
    return stream.getvalue()


def test_the_terminal_shows_table_4_and_the_findings_in_80_columns(study: dict[str, Any]) -> None:
    shown = printed(study)
    assert "…" not in shown
    assert max(map(len, shown.splitlines())) <= 80
    for title in ("Table 4.", "Against the bound", "Do the singular values win", "Statement"):
        assert title in shown
