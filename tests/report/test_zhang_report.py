"""The report of the study ``zhang``: made of its document alone, whatever that holds."""

from __future__ import annotations

import copy
import io
import json
import re
import warnings
from typing import Any

import pytest
from conftest import ROOT
from rich.console import Console
from sample_documents import hollow

from stcal.report import zhang_content as content
from stcal.report import zhang_figures as figures
from stcal.report import zhang_mounting_content as mounting
from stcal.report.content import Table
from stcal.report.study_content import findings, summary
from stcal.report.zhang_html import render, study_tables
from stcal.simulate import load_scenario
from stcal.studies.zhang import run_study

ATTACK = "</script><b>x</b>"


@pytest.fixture(scope="module")
def study() -> dict[str, Any]:
    scenario = load_scenario(ROOT / "configs" / "scenarios" / "zhang2024.toml")
    return json.loads(json.dumps(run_study(scenario, 2, 1, length_s=12.0, alignment_s=8.0)))


def rows(table: Table) -> dict[str, tuple[str, ...]]:
    return {row[0]: row[1:] for row in table.rows}


def test_published_values_stand_beside_ours(study: dict[str, Any]) -> None:
    errors = rows(content.error_table(study))
    assert [cells[0] for cells in errors.values()] == ["0.01", "0.03", "0.001", "0.03", "0.004"]
    found = study["errors"]["filters"]["ukf_cosine"]
    averaged = abs(found["averaged"]["x0_px"])
    assert errors["x0 [px]"][1] == f"{averaged:.2g}"
    assert errors["k1 [10⁻⁸ px⁻²]"][3] == f"{1e8 * found['rms']['k1_per_px2']:.2g}"
    assert errors["f [mm]"][6] == f"{1e3 * study['errors']['bound']['f_m']:.2g}"
    averages = rows(content.convergence_table(study))
    assert [cells[4] for cells in averages.values()] == [
        "499.81", "529.68", "74.002", "1.95", "−0.964",
    ]  # fmt: skip
    assert averages["y0 [px]"][6] == "530.00"
    squares = rows(content.mean_square_table(study))
    assert [cells[0] for cells in squares.values()] == ["0.1", "0.0013"]


def test_the_bound_of_an_average_is_a_hundredth_in_squares(study: dict[str, Any]) -> None:
    for cells in rows(content.mean_square_table(study)).values():
        assert float(cells[5]) == pytest.approx(float(cells[4]) / 100.0, rel=0.06)


def test_mountings_with_their_sd(study: dict[str, Any]) -> None:
    found = rows(mounting.mounting_table(study))
    assert found["Published"][:3] == ("4.4", "3.3", "0.00760")
    assert found["Printed matrices"][:2] == ("5.1", "3.3")
    read = study["alignment"]["cameras"]["true"]["linear"]["read"]
    assert found["True, linear"][0] == f"{1e5 * read['element']:.2g}"
    assert found["True, linear"][4:6] == (f"{read['own_sd_deg']:.5f}",) * 2
    # Nine elements have no sd of a rotation.
    assert found["True, nine elements"][4:] == ("",) * 4
    matrices = rows(mounting.matrix_table(study))
    assert matrices["x"][1] == "0.99969, 0.01735, −0.01742"


def test_levels_and_cases_have_a_row_each(study: dict[str, Any]) -> None:
    noise = rows(content.noise_table(study))
    assert len(noise) == 10
    value = study["noise_levels"][4]["filters"]["ukf_cosine"]["rms"]["y0_px"]
    assert noise["1 px, Paper's filter"][1] == f"{value:.2g}"
    cases = rows(content.low_frequency_table(study))
    assert len(cases) == 8
    told = study["low_frequency"][1]["filters"]["sqrf_arclength"]["consistency"]["f_m"]
    assert cases["distortion of the field (0.05 px): RMS / own sd"][2] == f"{told:.2f}"
    assert "both (0.2 px, 0.05 px): RMS" in cases
    spot = rows(content.spot_table(study))
    assert spot["Correct"][:3] == ("−0.016404", "0.004259", "0.999856")
    assert spot["Correct"][3] == "0"


def texts(svg: str | None) -> list[str]:
    assert svg is not None
    assert len(svg) < 150_000
    return re.findall(r"<text[^>]*>([^<]*)</text>", svg)


def test_figures_are_drawn_with_every_curve(study: dict[str, Any]) -> None:
    lines = {"bound of one run", "Paper's filter, RMS", "SQRF, arclengths, RMS"}
    shown = set(texts(figures.convergence(study, "a")))
    assert lines | {"Paper's filter, own sd", "Paper's filter, averaged", "published"} <= shown
    assert {"x0 [px]", "k2 [10⁻¹⁴ px⁻⁴]", "time [s]"} <= shown
    assert lines | {"noise [px]"} <= set(texts(figures.noise_levels(study, "b")))
    shown = set(texts(figures.mean_square(study, "c")))
    assert {"Paper's filter, averaged curve", "SQRF, arclengths, single runs", "published"} <= shown
    for kind in ("distortion", "image"):
        largest = study["distortion"]["ukf_cosine"]["largest"][kind]["px"]
        shown = texts(figures.residual_distortion(study, "ukf_cosine", kind, "d"))
        assert f"Paper's filter: largest {largest:.2g} px" in shown
    shown = set(texts(figures.mounting(study, "e")))
    assert {"Paper's filter", "SQRF, arclengths", "true camera", "published"} <= shown
    # Logarithmic scales have plain numbers.
    assert not any("mathdefault" in text for text in shown)


DRAWN = (
    figures.convergence,
    figures.noise_levels,
    figures.mean_square,
    figures.mounting,
    lambda d, n: figures.residual_distortion(d, "ukf_cosine", "image", n),
)


@pytest.mark.parametrize("draw", DRAWN)
def test_a_figure_without_data_is_none(draw: Any, study: dict[str, Any]) -> None:
    assert draw({}, "n") is None
    assert draw(hollow(study), "n") is None


def test_a_map_with_a_hole_is_none(study: dict[str, Any]) -> None:
    document = copy.deepcopy(study)
    document["distortion"]["ukf_cosine"]["image"][3] = None
    assert figures.residual_distortion(document, "ukf_cosine", "image", "n") is None
    assert figures.residual_distortion(document, "ukf_cosine", "distortion", "n") is not None


def test_the_page_shows_findings_tables_and_figures(study: dict[str, Any]) -> None:
    html = render(study)
    assert html.count('<div class="finding"') == 9
    assert html.count("<svg ") == 8
    for heading in ("Table 3", "Table 4", "Table 5", "Figures 7 and 8", "Figure 9", "Figure 10",
                    "Figure 11", "Figure 12"):  # fmt: skip
        assert f"<h3>{heading}. " in html
    assert summary(findings(study)) in html


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
    emptied = copy.deepcopy(study) | {"alignment": {}, "noise_levels": [3, None, {}]}
    for document in (hollow(study), emptied, schema, schema | {"errors": [], "convergence": 3}):
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


def test_the_terminal_shows_both_stages_and_the_findings_in_80_columns(
    study: dict[str, Any],
) -> None:
    shown = printed(study)
    assert "…" not in shown
    lines = [line.split() for line in shown.splitlines()]
    assert ["Published", "4.4", "3.3", "0.00760"] in lines
    assert any(line[:3] == ["x0", "[px]", "0.01"] for line in lines)
    assert "Finding of the paper" in " ".join(shown.split())
