from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from sample_documents import fit_document, hollow, validation_document

from stcal.cli import main
from stcal.report import content
from stcal.report.format import (
    count,
    decimals_for,
    fixed,
    interval,
    measured,
    percent,
    rms,
    significant,
    spread,
    vector,
)
from stcal.report.tables import fit_tables, summary_table, validation_tables
from stcal.units import unit_of


def printed(show: Any, document: Any, width: int = 100) -> str:
    stream = io.StringIO()
    show(document, Console(file=stream, width=width, color_system=None))
    return stream.getvalue()


def lines(text: str) -> list[list[str]]:
    return [line.split() for line in text.splitlines()]


def test_fit_tables_show_the_numbers() -> None:
    text = printed(fit_tables, fit_document())
    assert text.splitlines()[0].strip() == "ST16-1: Fit accepted"
    rows = lines(text)
    assert ["Common-pair", "RMS", "[µrad]", "422.6", "80.3", "0.190"] in rows
    f = ["f", "[mm]", "16.00000", "15.98712", "0.00031", "−0.01288", "−1.61", "−41.5"]
    assert f in rows
    # No-break spaces within a number must not split it.
    cycle = ["1", "telemetry", "105", "1\u202f700", "600", "94.0", "1.025", "–"]
    assert cycle in [[cell for cell in line.split(" ") if cell] for line in text.splitlines()]
    assert "known 131" in " ".join(text.split())
    assert "−3051.22, +2711.90, +14.05 arcsec" in text


def test_validation_tables_show_the_numbers() -> None:
    document = validation_document()
    document["verdict"] = {
        "accepted": False,
        "reasons": ["ratio [bold]0.97[/bold] is below 1"],
        "notes": ["within its uncertainty"],
    }
    text = printed(validation_tables, document)
    assert "ST16-1: Validation refused" in text
    assert "ratio [bold]0.97[/bold] is below 1" in text
    assert "note: within its uncertainty" in text
    rows = lines(text)
    assert ["Availability", "44.1", "%", "97.9", "%", "2.218"] in rows
    assert ["(35.2", "to", "53.1)", "(95.1", "to", "100.0)"] in rows
    assert ["(351.0", "to", "402.0)", "(86.0", "to", "94.0)", "(0.221", "to", "0.260)"] in rows
    assert "5\u202f120" in text


def test_terminal_width_80_cuts_nothing() -> None:
    assert "…" not in printed(fit_tables, fit_document(), width=80)
    assert "…" not in printed(validation_tables, validation_document(), width=80)
    row = content.summary_row(validation_document())
    assert "…" not in printed(summary_table, [row], width=80)


def test_hollow_documents_print() -> None:
    assert "Fit: verdict not available" in printed(fit_tables, hollow(fit_document()))
    assert "not available" in printed(validation_tables, hollow(validation_document()))


def test_escape_sequences_do_not_reach_the_terminal() -> None:
    document = fit_document()
    document["sensor_id"] = "ST\x1b[31m16"
    document["verdict"] = {"accepted": False, "reasons": ["a\x1b]0;owned\x07b"]}
    assert "\x1b" not in printed(fit_tables, document)


def test_summary_is_enright_table_iv() -> None:
    row = content.summary_row(validation_document())
    assert row == {
        "sensor_id": "ST16-1",
        "availability": {"baseline": 0.4412, "candidate": 0.9787},
        "matched_star_ratio": 2.4606,
        "common_pair_rms_urad": {"baseline": 377.04, "candidate": 89.93},
        "accepted": True,
    }
    empty = content.summary_row({"schema": "stcal.validation/1"})
    text = printed(summary_table, [row, empty], width=80)
    rows = lines(text)
    assert ["ST16-1", "0.44", "0.98", "2.46", "377.0", "89.9", "accepted"] in rows
    assert [*"–––––", "–", "unknown"] in rows


def test_summary_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = []
    for k, accepted in enumerate((True, False)):
        document = validation_document() | {"sensor_id": f"ST16-{k}"}
        document["verdict"] = {"accepted": accepted, "reasons": []}
        paths.append(tmp_path / f"{k}.json")
        paths[-1].write_text(json.dumps(document))
    names = [str(path) for path in paths]
    assert main(["summary", *names, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert [row["accepted"] for row in answer["sensors"]] == [True, False]
    assert main(["summary", *names]) == 0
    rows = lines(capsys.readouterr().out)
    assert ["ST16-1", "0.44", "0.98", "2.46", "377.0", "89.9", "refused"] in rows
    assert main(["summary", str(tmp_path / "none.json")]) == 3
    assert "none.json" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "symbol", "si", "shown", "size"),
    [
        ("f_m", "f", "m", "mm", 1e-3),
        ("m0_px", "m0", "px", "px", 1.0),
        ("b4_per_m4", "b4", "m^-4", "10⁸ m⁻⁴", 1e8),
        ("b2_per_m2", "b2", "m^-2", "10³ m⁻²", 1e3),
        ("b6_per_m6", "b6", "m^-6", "10¹³ m⁻⁶", 1e13),
        ("a1_rad", "a1", "rad", "mrad", 1e-3),
        ("g_y", "g_y", "1", "", 1.0),
        ("k1", "k1", "1", "", 1.0),
        ("k1_per_px2", "k1", "px^-2", "10⁻⁸ px⁻²", 1e-8),
        ("k2_per_px4", "k2", "px^-4", "10⁻¹⁴ px⁻⁴", 1e-14),
        ("_m", "_m", "1", "", 1.0),
    ],
)
def test_units_by_suffix(name: str, symbol: str, si: str, shown: str, size: float) -> None:
    unit = unit_of(name)
    assert (unit.symbol, unit.si, unit.shown) == (symbol, si, shown)
    assert unit.size == pytest.approx(size, rel=1e-15)


def test_numbers_as_text() -> None:
    assert fixed(-0.001, 2) == "0.00"
    assert fixed(-1.005, 1, signed=True) == "−1.0"
    assert fixed(float("nan")) == fixed(None) == fixed("3") == fixed(True) == "not available"
    assert percent(0.9787) == "97.9 %"
    assert rms(999.96) == "1000.0"
    assert rms(7884.2) == "7884"
    assert count(2400) == "2\u202f400"
    assert measured(15.98712345, 0.00031) == "15.98712"
    assert measured(1012.44, 26.0) == "1012"
    assert measured(1.5, None) == "1.5"
    assert spread(0.00031) == "0.00031"
    assert spread(0.0) == "0"
    assert decimals_for(1e-30) == 12
    assert significant(3.2e14, 2) == "3.2e+14"
    assert interval([0.5, 0.25], 1, 100.0) == "50.0 to 25.0"
    assert interval([0.5], 1) == interval(None, 1) == "not available"
    assert vector([1.0, -2.0, 0.0]) == "+1.00, −2.00, 0.00"
    assert vector([1.0, None]) == "not available"


def test_field_rms_is_over_vectors() -> None:
    field = {
        "before_row_px": [3.0, 0.0, None, 9.0],
        "before_col_px": [4.0, 0.0, 1.0, 9.0],
        "count": [1, 3, 5, 0],
    }
    assert content.field_rms({"field": field}, "before") == pytest.approx(5 / 4**0.5)
