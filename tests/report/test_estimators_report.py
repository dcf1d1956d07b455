"""The report of the study of all combinations, and the documentation's page made of it."""

from __future__ import annotations

import copy
import io
import itertools
import re
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT
from rich.console import Console
from sample_documents import hollow

from stcal.report import estimators_content as content
from stcal.report import estimators_figures as figures
from stcal.report.document import ESTIMATORS_SCHEMA
from stcal.report.estimators_html import render, study_tables
from stcal.report.estimators_page import page, table_text, write_page

PAGE = ROOT / "docs" / "which-estimator.md"
ATTACK = "</script><b>x</b>"
COMMAND = "stcal study estimators --out x"
RESIDUALS = ("direction", "arclength", "singular-values", "cosine")
ESTIMATORS = ("batch", "ekf", "sqrf", "ukf", "smoother")
PAIRS = list(itertools.product(RESIDUALS, ESTIMATORS))
CAMERAS = {"wang": "ST16-4", "pinhole-radial": "WU-1", "pixel-radial": "ZHANG-1"}


def combination(pair: tuple[str, str], **changes: Any) -> dict[str, Any]:
    return {
        "residual": pair[0], "estimator": pair[1], "refused": 0, "over_bound": 1.02,
        "error_over_sd": 1.01, "us_per_frame": 431.0, "kept_bytes": 375312.0, **changes,
    }  # fmt: skip


def summary(pair: tuple[str, str], **changes: Any) -> dict[str, Any]:
    return {
        "residual": pair[0], "estimator": pair[1], "refused": 0, "over_efficient": 1.01,
        "honesty": 1.02, "us_per_frame": 431.0, "robust": 0.9, "eligible": True, **changes,
    }  # fmt: skip


@pytest.fixture
def document() -> dict[str, Any]:
    sensors = {
        sensor: {
            "sensor_id": sensor, "camera": camera, "name": f"sensor {sensor}", "stars": 11.0,
            "bound_urad": 3.7, "initial_over_bound": 160.0, "efficient_over_bound": 0.97,
            "combinations": [combination(pair) for pair in PAIRS],
        }
        for camera, sensor in CAMERAS.items()
    }  # fmt: skip
    robust = [
        {
            "residual": pair[0],
            "estimator": pair[1],
            "starts": {"well": [1.0, 0.6, 0.2]},
            "false_matches": {"well": [1.0, 0.8, 0.0]},
        }
        for pair in PAIRS
    ]
    return {
        "schema": ESTIMATORS_SCHEMA, "software": "stcal 0", "created_utc": "now",
        "seed": 1, "runs": 10, "frames": 200, "machine": "a processor", "well": 3.0,
        "sensors": sensors,
        "robustness": {
            "sensor_id": "ST16-4", "camera": "wang", "runs": 5, "frames": 100,
            "start_sigma": [4.0, 8.0, 16.0], "false_shares": [0.01, 0.03, 0.1],
            "combinations": robust,
        },
        "choice": {
            "rule": {"accurate": 1.1, "honest": 1.2, "robust": 1.0, "fast": 1.1},
            "summaries": [
                summary(pair, **({"over_efficient": 1.63, "eligible": False}
                                 if pair[0] == "cosine" else {}))
                for pair in PAIRS
            ],
            "ground": summary(("arclength", "batch")),
            "on_board": summary(("direction", "ukf"), us_per_frame=630.0),
        },
        "findings": [],
    }  # fmt: skip


def test_the_answer_follows_the_choice(document: dict[str, Any]) -> None:
    ground, on_board, spread, avoided = content.answer(document)
    assert ground.startswith("On the ground, use batch with arclength:")
    assert on_board.startswith("On board, with memory that does not grow, use ukf with direction:")
    assert "630 µs a frame" in on_board
    assert "90 % of the runs" in on_board
    assert "The residual decides" in spread
    assert "61.4 %" in spread
    assert avoided.endswith("cosine (error over the efficient estimate's 1.63).")
    document["choice"]["summaries"][0] |= {"refused": 4, "eligible": False}
    assert "preferred: direction / batch (4 refused), cosine (" in content.answer(document)[3]
    document["choice"]["on_board"] = document["choice"]["ground"]
    assert content.answer(document)[0].startswith("On the ground and on board alike, use batch")
    document["choice"]["on_board"] = None
    assert content.answer(document)[1].endswith("no combination met the rule in this run.")


def test_the_table_has_every_combination_and_robustness_of_one_camera(
    document: dict[str, Any],
) -> None:
    sensor = document["sensors"]["WU-1"]
    sensor["combinations"][3] = combination(PAIRS[3], refused=2, over_bound=7.5)
    table = content.whole_table(document)
    assert len(table.rows) == 60
    assert {len(row) for row in table.rows} == {len(table.header)} == {13}
    assert table.rows[23][:4] == ("pinhole-radial", "direction", "ukf", "7.50 (2)")
    assert table.rows[0][7:] == ("100 %", "60 %", "20 %", "100 %", "80 %", "0 %")
    assert set(table.rows[20][7:]) == {"–"}
    assert table.rows[0][6] == "375"


def test_the_page_is_made_of_the_document_alone(document: dict[str, Any]) -> None:
    text = page(document, "which-estimator", COMMAND)
    assert text == page(copy.deepcopy(document), "which-estimator", COMMAND)
    assert text.index("On the ground, use") < text.index("| Camera |")
    assert table_text(content.whole_table(document)) in text
    assert "](which-estimator-accuracy.svg)" in text
    assert f"```\n{COMMAND}\n```" in text
    assert "not available" not in text


def test_the_page_and_its_plots_are_written(document: dict[str, Any], tmp_path: Path) -> None:
    write_page(document, tmp_path / "p.md", COMMAND)
    for name in re.findall(r"\]\((.+?\.svg)\)", (tmp_path / "p.md").read_text()):
        svg = (tmp_path / name).read_text()
        assert svg.startswith('<svg xmlns="http://www.w3.org/2000/svg"')
        assert "<script" not in svg
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "p-accuracy.svg", "p-robustness.svg", "p.md",
    ]  # fmt: skip


def _value(cell: str) -> float:
    return float(re.sub(r"[\u202f\u00a0 %]", "", cell).replace("−", "-"))


def _document_of(lines: list[str], document: dict[str, Any]) -> dict[str, Any]:
    """Return a document with the figures of a page's table."""
    header, _, *body = ([cell.strip() for cell in line.strip("|").split("|")] for line in lines)
    found = copy.deepcopy(document)
    robust = found["robustness"]
    robust["start_sigma"] = [_value(h.split()[0]) for h in header if h.endswith("σ off")]
    robust["false_shares"] = [_value(h.split()[0]) / 100.0 for h in header if h.endswith("false")]
    starts = len(robust["start_sigma"])
    robust["combinations"] = []
    for sensor in found["sensors"].values():
        sensor["combinations"] = []
        for camera, residual, estimator, error, z, us, kept, *ends in body:
            if camera != sensor["camera"]:
                continue
            pair = {"residual": residual, "estimator": estimator}
            over, _, refused = error.partition(" (")
            sensor["combinations"].append({
                **pair, "over_bound": None if "not" in over else _value(over),
                "refused": int(refused.rstrip(")") or 0),
                "error_over_sd": None if "not" in z else _value(z),
                "us_per_frame": None if "not" in us else _value(us),
                "kept_bytes": None if "not" in kept else 1e3 * _value(kept),
            })  # fmt: skip
            if "–" not in ends:
                shares = [_value(cell) / 100.0 for cell in ends]
                robust["combinations"].append({
                    **pair, "starts": {"well": shares[:starts]},
                    "false_matches": {"well": shares[starts:]},
                })  # fmt: skip
    return found


def test_the_committed_table_is_what_the_code_makes(document: dict[str, Any]) -> None:
    text = PAGE.read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if line.startswith("|")]
    made = table_text(content.whole_table(_document_of(lines, document))).splitlines()
    assert lines == [line for line in made if line.startswith("|")]
    rows = [tuple(cell.strip() for cell in line.strip("|").split("|")[:3]) for line in lines[2:]]
    assert rows == [(camera, *pair) for camera in CAMERAS for pair in PAIRS]


def test_the_committed_page_is_complete(document: dict[str, Any]) -> None:
    text = PAGE.read_text(encoding="utf-8")
    made = page(document, PAGE.stem, COMMAND)
    headings = [line for line in made.splitlines() if line.startswith("#")]
    assert [line for line in text.splitlines() if line.startswith("#")] == headings
    for name in re.findall(r"\]\((.+?\.svg)\)", text):
        assert (PAGE.parent / name).is_file()
    assert "stcal study estimators --out study/estimators --page docs/which-estimator.md" in text


def test_nothing_passes_unescaped(document: dict[str, Any]) -> None:
    for row in document["sensors"]["ST16-4"]["combinations"]:
        row["residual"] = ATTACK
    for row in document["choice"]["summaries"]:
        row["residual"] = ATTACK
    document["machine"] = ATTACK
    document["choice"]["ground"]["residual"] = ATTACK
    assert ATTACK not in render(document)
    assert ATTACK not in page(document, "x", COMMAND)


def test_whatever_the_document_holds(document: dict[str, Any]) -> None:
    console = Console(file=io.StringIO(), width=80)
    for broken in ({}, hollow(document)):
        assert "</html>" in render(broken)
        assert page(broken, "x", COMMAND).startswith("# Which estimator")
        study_tables(broken, console)


def test_figures_without_data_are_none() -> None:
    assert figures.accuracy_and_time({}, "a") is None
    assert figures.robustness({}, "a") is None


def test_the_terminal_holds_the_tables(document: dict[str, Any]) -> None:
    stream = io.StringIO()
    study_tables(document, Console(file=stream, width=80))
    assert "On the ground, use" in stream.getvalue()
    assert "direction / sqrf" in stream.getvalue()
