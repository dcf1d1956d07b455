from __future__ import annotations

import copy
import io
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from sample_documents import hollow

from stcal.report import conversion_content, conversion_figures
from stcal.report.conversion_html import render
from stcal.report.html import write_report
from stcal.report.tables import conversion_tables

SHAPE = (23, 41)


def conversion_document() -> dict[str, Any]:
    """Synthetic: plausible in shape and size, the numbers mean nothing."""
    row, col = np.meshgrid(
        np.linspace(-0.5, 1079.5, SHAPE[0]), np.linspace(-0.5, 1919.5, SHAPE[1]), indexing="ij"
    )
    d_row, d_col = 1e-5 * (row - 540.0), 2e-9 * (col - 960.0) ** 3
    field = {
        "row_px": row, "col_px": col, "error_row_px": d_row, "error_col_px": d_col,
        "error_urad": 181.0 * np.hypot(d_row, d_col),
    }  # fmt: skip
    wu = {"aspect": 1.00002, "f_m": 0.01601, "u0_px": 962.0, "v0_px": 545.0, "k1": -0.43,
          "k2": 0.2}  # fmt: skip
    zhang = {"x0_px": 545.0, "y0_px": 962.0, "f_m": 0.01601, "k1_per_px2": 1.364e-8,
             "k2_per_px4": 7.3e-16}  # fmt: skip
    sd = {"aspect": 2e-5, "f_m": 7e-7, "k1_per_px2": 1.5e-10, "k2_per_px4": 1.2e-16}
    listed = [
        [{"name": name, "value": value, "sd": sd.get(name)} for name, value in camera.items()]
        for camera in (wu, zhang)
    ]
    return {
        "schema": "stcal.conversion/1",
        "sensor_id": "WU-1",
        "software": "stcal 0.0 (synthetic)",
        "verdict": {"accepted": True, "reasons": [], "notes": ["a note"]},
        "old": {"serial": 2, "model": "pinhole-radial", "parameters": listed[0], "file": "wu.json",
                "sha256": "a" * 64},
        "new": {"serial": 3, "model": "pixel-radial", "parameters": listed[1]},
        "turn_arcsec": [-0.0194, 0.1581, 0.0],
        "errors": {"worst_urad": 321.44, "worst_px": 1.775, "at_row_px": -0.5,
                   "at_col_px": 1919.5, "rms_urad": 98.7, "rms_px": 0.5456, "maximum_urad": 500.0},
        "field": {"rows": 1080, "cols": 1920}
        | {key: value.ravel().tolist() for key, value in field.items()},
    }  # fmt: skip


def texts(svg: str | None) -> list[str]:
    assert svg is not None
    return re.findall(r"<text[^>]*>([^<]*)</text>", svg)


def test_tables_say_how_far_and_where() -> None:
    rows = dict(conversion_content.error_table(conversion_document()).rows)
    assert rows["Worst error of a direction"] == "321 µrad"
    assert rows["at"] == "row −0.5, column 1919.5"
    assert rows["Worst error of a centroid"] == "1.77 px"
    assert rows["RMS error of the directions"] == "98.7 µrad"
    assert rows["Largest error allowed"] == "500 µrad"
    assert rows["Turn of D, taken up by C_SD, x y z"] == "−0.019, +0.158, 0.000 arcsec"


def test_parameters_are_in_the_units_of_their_model() -> None:
    old, new = (
        conversion_content.parameter_table(conversion_document(), which) for which in ("old", "new")
    )
    assert old.title == "Old camera: pinhole-radial, serial 2"
    assert ("aspect", "1.000020", "0.000020") in old.rows
    assert ("k1", "−0.43", "not available") in old.rows
    assert ("k1 [10⁻⁸ px⁻²]", "1.364", "0.015") in new.rows
    assert ("k2 [10⁻¹⁴ px⁻⁴]", "0.073", "0.012") in new.rows
    assert new.rows[0][0] == "x0 [px]"


def test_the_terminal_shows_verdict_errors_and_new_parameters() -> None:
    stream = io.StringIO()
    conversion_tables(conversion_document(), Console(file=stream, width=100, color_system=None))
    shown = stream.getvalue()
    for part in ("WU-1: Conversion accepted", "note: a note", "321 µrad", "k2 [10⁻¹⁴ px⁻⁴]"):
        assert part in shown
    assert "aspect" not in shown


def test_the_map_names_its_axes_and_its_scale() -> None:
    svg = conversion_figures.error_map(conversion_document()["field"], "m")
    shown = texts(svg)
    for label in ("column n [px]", "row m [px]", "error of the direction [µrad]",
                  "Longest arrow 1.8 px"):  # fmt: skip
        assert label in shown
    assert svg is not None
    assert len(svg) < 150_000


def test_arrows_follow_rows_and_columns() -> None:
    """All arrows alike: the outline of the first lies along its direction."""
    field = conversion_document()["field"]
    count = len(field["row_px"])
    spans = []
    for d_row, d_col in ((0.0, 1.0), (1.0, 0.0)):
        field |= {"error_row_px": [d_row] * count, "error_col_px": [d_col] * count}
        svg = conversion_figures.error_map(field, "m")
        assert svg is not None
        (outline,) = re.findall(r'<path d="([^"]*)"[^>]*fill: #4d4d4d', svg)[:1]
        points = np.array(re.findall(r"[ML] ?([-\d.]+) ([-\d.]+)", outline), dtype=float)
        spans.append(np.ptp(points, axis=0))
    assert spans[0][0] > 2.0 * spans[0][1]
    assert spans[1][1] > 2.0 * spans[1][0]


def test_no_map_without_a_whole_grid_or_an_error() -> None:
    field = conversion_document()["field"]
    broken: list[dict[str, Any]] = [
        {},
        field | {"error_urad": [0.0] * len(field["row_px"])},
        field | {"error_urad": field["error_urad"][:-1]},
        field | {"error_urad": [None, *field["error_urad"][1:]]},
        field | {"row_px": [5.0] * len(field["row_px"])},
        field | {"rows": None},
        {key: value[:-1] if isinstance(value, list) else value for key, value in field.items()},
    ]
    for section in broken:
        assert conversion_figures.error_map(section, "m") is None


def test_the_report_starts_with_its_verdict(tmp_path: Path) -> None:
    document = conversion_document()
    html = render(document)
    assert html.index("Conversion accepted") < html.index("<h1>Conversion of WU-1")
    assert html.count("<svg") == 1
    for shown in ("321 µrad", "a" * 64, "Old camera: pinhole-radial", "New camera: pixel-radial"):
        assert shown in html
    assert "http" not in html
    write_report(document, tmp_path / "r.html")
    assert (tmp_path / "r.html").read_text() == html


@pytest.mark.parametrize("junk", ["text", 3, [1, "x", None], {"a": [{}]}, None, [[[]]]])
def test_any_section_of_another_type_still_renders(junk: object) -> None:
    document = conversion_document()
    assert "nan" not in render(hollow(document)).lower().split()
    render({"schema": document["schema"]})
    render(dict.fromkeys(document, junk))
    nested = copy.deepcopy(document)
    for value in nested.values():
        if isinstance(value, dict):
            value.update(dict.fromkeys(value, junk))
    render(nested)


def test_strings_are_escaped() -> None:
    document = conversion_document()
    attack = "<script>alert(1)</script>"
    document["sensor_id"] = document["old"]["file"] = document["new"]["model"] = attack
    document["new"]["parameters"][0]["name"] = attack
    assert "<script>" not in render(document)


def test_bytes_are_reproducible_in_another_process() -> None:
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]);"
        "from test_conversion_report import conversion_document as d;"
        "from stcal.report.conversion_html import render as r;"
        "sys.stdout.buffer.write(r(d()).encode())"
    )
    other = subprocess.run(
        [sys.executable, "-c", code, str(Path(__file__).parent)], capture_output=True, check=True
    )
    assert other.stdout == render(conversion_document()).encode()
