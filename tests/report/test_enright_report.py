"""The report of the study ``enright``: made of its document alone, whatever that holds."""

from __future__ import annotations

import copy
import io
import json
import re
import warnings
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT
from rich.console import Console
from sample_documents import hollow

from stcal.cli import main
from stcal.report import enright_basis, enright_content, enright_figures
from stcal.report.html import write_report
from stcal.report.study_content import findings, summary
from stcal.report.tables import enright_tables
from stcal.simulate import load_scenario
from stcal.studies.enright import run_study
from stcal.studies.scenarios import shortened

# So few frames that the gates refuse every fit.
FRAMES = 24
ATTACK = "</script><b>x</b>"


@pytest.fixture(scope="module")
def study() -> dict[str, Any]:
    scenario = load_scenario(ROOT / "configs" / "scenarios" / "st16-2.toml")
    return json.loads(json.dumps(run_study({2: shortened(scenario, FRAMES)}, 1)))


def rendered(document: dict[str, Any], folder: Path) -> str:
    path = folder / "study.html"
    write_report(document, path)
    return path.read_text(encoding="utf-8")


def rows(table: enright_content.Table) -> dict[str, tuple[str, ...]]:
    return {row[0]: row[1:] for row in table.rows}


def camera(study: dict[str, Any], name: str) -> dict[str, Any]:
    return study["sensors"][0]["validation"]["cameras"][name]


def test_papers_values_stand_above_ours(study: dict[str, Any]) -> None:
    changes = enright_content.change_table(study)
    assert [row[0] for row in changes.rows[:2]] == ["f, paper", "f, stcal"]
    assert rows(changes)["n0, paper"] == ("−8.37",)
    assert re.fullmatch(r"−\d\.\d\d ± 0\.\d\d", rows(changes)["f, stcal"][0])
    assert rows(enright_content.performance_table(study))["2, paper"][:5] == (
        "0.98", "1.00", "1.20", "332.7", "91.4",
    )  # fmt: skip
    errors = rows(enright_content.error_table(study))
    assert errors["2, paper"] == ("316.9", "106.8", "118.9", "106.4", "102.1", "")
    assert errors["2, stcal"][1] == f"{camera(study, 'batch')['rms_urad']:.1f}"
    assert errors["2R, stcal"][1] == f"{camera(study, 'batch_reduced')['rms_urad']:.1f}"
    assert "2R, paper" not in errors
    matching = rows(enright_content.matching_table(study))
    assert matching["2, paper"][:4] == ("1.16",) * 4
    assert matching["2, stcal"][0] == f"{camera(study, 'batch')['matched_star_ratio']:.2f}"
    distortion = rows(enright_content.distortion_table(study))
    assert distortion["b4 [10⁸ m⁻⁴], paper"] == ("1.370", "0.583", "0.320", "1.374", "")
    assert float(distortion["f [mm], stcal"][4]) == pytest.approx(15.93568, abs=1e-4)


def test_a_change_is_shown_in_sigma(study: dict[str, Any]) -> None:
    document = copy.deepcopy(study)
    row = document["sensors"][0]["parameters"][0]
    row |= {"initial": 0.016, "sigma": 8e-6}
    row["fitted"]["batch"], row["sd"]["batch"] = 0.016 - 12e-6, 2e-6
    assert rows(enright_content.change_table(document))["f, stcal"] == ("−1.50 ± 0.25",)


def test_refused_fits_are_told_with_their_reasons(study: dict[str, Any]) -> None:
    table = enright_basis.gate_table(study)
    assert len(table.rows) == 11
    assert all("frames identified, at least 30 needed" in row[2] for row in table.rows)
    assert "Refused 11 of 11 fits." in table.note
    # Their cameras are evaluated all the same.
    assert camera(study, "no_refit_reduced")["rms_urad"] > 0
    accepted = copy.deepcopy(study)
    for item in accepted["sensors"][0]["gates"]:
        item |= {"accepted": True, "reasons": []}
    assert enright_basis.gate_table(accepted).rows[0][0] == "none"


def texts(svg: str | None) -> list[str]:
    assert svg is not None
    assert len(svg) < 150_000
    return re.findall(r"<text[^>]*>([^<]*)</text>", svg)


def test_figures_are_drawn_with_every_curve(study: dict[str, Any]) -> None:
    sensor = study["sensors"][0]
    shown = texts(enright_figures.convergence(sensor, "a"))
    assert {"Q", "No-Q", "No-Refit", "f minus batch value [µm]", "frame"} <= set(shown)
    aggregate = sensor["errors"]["no_q"]["aggregate_urad"]
    shown = texts(enright_figures.errors(sensor, "b"))
    assert {"Q, tail", "No-Q, tail", f"No-Q, aggregate {aggregate:.1f}"} <= set(shown)
    shown = texts(enright_figures.radial(sensor, "c"))
    assert {"Q", "No-Q", "No-Refit", "true camera"} <= set(shown)
    shown = texts(enright_figures.settling(sensor, "d"))
    assert {"Availability", "Common-pair RMS", "processed frames"} <= set(shown)


def test_a_figure_without_data_is_none(study: dict[str, Any]) -> None:
    for draw in (
        enright_figures.convergence,
        enright_figures.errors,
        enright_figures.radial,
        enright_figures.settling,
    ):
        assert draw({}, "n") is None
        assert draw(hollow(study["sensors"][0] | {"schema": ""}), "n") is None


def test_the_page_shows_findings_tables_and_figures(study: dict[str, Any], tmp_path: Path) -> None:
    html = rendered(study, tmp_path)
    assert html.count('<div class="finding"') == 9
    assert html.count("<svg ") == 4
    for k, number in enumerate(("III", "IV", "V", "VI", "VII")):
        assert f"<h3>Table {number}. " in html, k
    for number in ("3", "4", "5"):
        assert f"<h3>Figure {number}. " in html
    assert "Here six sensors are simulated" in html
    assert summary(findings(study)) in html


def test_a_verdict_has_its_grade(study: dict[str, Any], tmp_path: Path) -> None:
    grades = {"holds": "good", "partly": "fair", "does not hold": "bad", "not tested": "open"}
    document = study | {"findings": [dict(study["findings"][0], verdict=v) for v in grades]}
    html = rendered(document, tmp_path)
    for verdict, grade in grades.items():
        assert html.count(f'<span class="badge {grade}">{verdict}</span>') == 2
    assert summary(findings(document)) == (
        "Of 4 findings of the paper, 1 holds, 1 holds in part, 1 does not hold, "
        "1 could not be tested."
    )


def test_nothing_from_outside_and_everything_escaped(study: dict[str, Any], tmp_path: Path) -> None:
    html = rendered(_attacked(study) | {"schema": study["schema"]}, tmp_path)
    assert ATTACK not in html
    assert "&lt;/script&gt;" in html
    assert "http" not in html
    assert "src=" not in html
    identifiers = re.findall(r'\sid="([^"]+)"', html)
    assert len(identifiers) == len(set(identifiers))
    assert set(re.findall(r'(?:href="#|url\(#)([^")]+)', html)) <= set(identifiers)


def _attacked(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _attacked(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_attacked(item) for item in value]
    return ATTACK if isinstance(value, str) else value


def test_hollow_documents_make_a_report(study: dict[str, Any], tmp_path: Path) -> None:
    emptied = study | {"sensors": [hollow(study["sensors"][0] | {"schema": ""})]}
    schema = {"schema": study["schema"]}
    for document in (hollow(study), emptied, schema, schema | {"sensors": [{}, 3, None]}):
        html = rendered(document, tmp_path)
        assert "not available" in html
        printed(document)


@pytest.mark.parametrize("number", [0, 1e12, 5e-324, 1e300, -1.0, True, "text"])
def test_any_numbers_make_a_report_without_warnings(
    number: object, study: dict[str, Any], tmp_path: Path
) -> None:
    document = _replaced(study, number)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for shown in ({}, dict.fromkeys(study["shown"], number)):
            assert "<h1>" in rendered(document | {"shown": shown}, tmp_path)
            printed(document)


def _replaced(value: Any, number: object) -> Any:
    if isinstance(value, dict):
        return {key: _replaced(item, number) for key, item in value.items()}
    if isinstance(value, list):
        return [_replaced(item, number) for item in value]
    return number if isinstance(value, int | float) else value


def printed(document: dict[str, Any]) -> str:
    stream = io.StringIO()
    enright_tables(document, Console(file=stream, width=80, color_system=None))
    return stream.getvalue()


def test_the_terminal_shows_table_v_and_the_findings_in_80_columns(study: dict[str, Any]) -> None:
    shown = printed(study)
    assert "…" not in shown
    assert ["2,", "paper", "316.9", "106.8", "118.9", "106.4", "102.1"] in [
        line.split() for line in shown.splitlines()
    ]
    words = " ".join(shown.split())
    assert "does not hold" in words
    assert "Finding of the paper" in words


def test_the_report_command_makes_the_same_page(
    study: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "study.json"
    path.write_text(json.dumps(study), encoding="utf-8")
    assert main(["report", str(path), "--out", str(tmp_path / "again.html"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["schemas"] == [study["schema"]]
    again = (tmp_path / "again.html").read_text(encoding="utf-8")
    assert again == rendered(study, tmp_path)
