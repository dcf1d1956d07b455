from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from catalog_official_files import hipparcos_line, supplement_line, tycho2_line, write

from stcal.catalog.build import build_catalogue
from stcal.catalog.catalogue import BUNDLED, catalogue_sha256, load, load_bundled
from stcal.cli import main


@pytest.fixture
def files(tmp_path: Path) -> dict[str, Path]:
    rows = [
        tycho2_line((1, 1, 1), 1.0, 1.0, bt=6.5, vt=6.0),
        tycho2_line((1, 2, 1), 2.0, 1.0, bt=7.5, vt=7.0, hip=5),
    ]
    spare = supplement_line((2, 1, 1), 3.0, 1.0, pm=(1.0, 2.0), bt=4.0, vt=3.5)
    hip = hipparcos_line(9, 1.0, 1.0, pm=(1.0, 1.0), parallax=3.0, hp=5.0, colour=0.5)
    return {
        "tycho2": write(tmp_path / "tyc2.dat", rows),
        "supplement": write(tmp_path / "suppl_1.dat", [spare]),
        "hipparcos": write(tmp_path / "hip2.dat", [hip]),
    }


def test_build_writes_what_the_core_makes(
    files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "c.npz"
    options = [part for name, path in files.items() for part in (f"--{name}", str(path))]
    assert main(["catalog", "build", *options, "--limit", "7.5", "--out", str(out), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    expected = build_catalogue([files["tycho2"]], files["supplement"], files["hipparcos"], 7.5)
    assert document["stars"] == expected.n_stars == 4
    assert document["sha256"] == catalogue_sha256(load(out)) == catalogue_sha256(expected)
    assert set(document["provenance"]["inputs"]) == {"tyc2.dat", "suppl_1.dat", "hip2.dat"}
    assert main(["catalog", "info", str(out)]) == 0
    shown = "".join(capsys.readouterr().out.split())
    assert expected.provenance["inputs"]["hip2.dat"] in shown


def test_info_describes_the_bundled_catalogue(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["catalog", "info", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    catalogue = load_bundled()
    assert document["file"] == str(BUNDLED)
    assert document["sha256"] == catalogue_sha256(catalogue)
    assert document["by_magnitude"][-1] == {
        "from": 7,
        "to": 8,
        "stars": int((catalogue.magnitude > 7.0).sum()),
        "so_far": catalogue.n_stars,
    }
    assert sum(row["stars"] for row in document["by_source"]) == catalogue.n_stars
    assert all(row["meaning"] for row in document["by_source"])
    assert document["with_colour"] == int(np.isfinite(catalogue.colour).sum())
    assert document["epoch"] == "J2000.0"
    assert main(["catalog", "info"]) == 0
    assert "46,132" in capsys.readouterr().out


def test_broken_input_ends_in_code_3_and_writes_nothing(
    files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = files["tycho2"]
    path.write_bytes(path.read_bytes()[:-50])
    out = tmp_path / "c.npz"
    assert main(["catalog", "build", "--tycho2", str(path), "--out", str(out)]) == 3
    assert "tyc2.dat: row 2: cut short" in capsys.readouterr().err
    assert not out.exists()
    out.write_bytes(BUNDLED.read_bytes()[:9999])
    assert main(["catalog", "info", str(out), "--json"]) == 3
    assert "c.npz: cut short" in json.loads(capsys.readouterr().out)["error"]
    assert main(["catalog", "build", "--out", str(out)]) == 2


def test_row_counts_that_are_not_the_official_ones_are_warned_of(
    files: dict[str, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out = tmp_path / "c.npz"
    options = [part for name, path in files.items() for part in (f"--{name}", str(path))]
    assert main(["catalog", "build", *options, "--out", str(out), "--json"]) == 0
    warnings = json.loads(capsys.readouterr().out)["warnings"]
    assert warnings == [
        f"{files['tycho2']}: 2 rows; the whole Tycho-2 main catalogue has 2,539,913",
        f"{files['supplement']}: 1 rows; the whole Tycho-2 supplement 1 has 17,588",
        f"{files['hipparcos']}: 1 rows; the whole Hipparcos-2 has 117,955",
    ]
    assert main(["catalog", "info", str(out)]) == 0
    assert capsys.readouterr().out.count("warning:") == 3
    # Two parts of Tycho-2 that together are whole, and no other file: nothing to warn of.
    official = {"tycho2": ("Tycho-2", 206, 4), "supplement": ("", 0, 9), "hipparcos": ("", 0, 9)}
    monkeypatch.setattr("stcal.catalog.build._OFFICIAL", official)
    parts = ["--tycho2", str(files["tycho2"])] * 2
    assert main(["catalog", "build", *parts, "--out", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["warnings"] == []


def test_out_that_cannot_be_a_file(
    files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for out in (tmp_path, files["tycho2"] / "x" / "c.npz"):
        assert main(["catalog", "build", "--tycho2", str(files["tycho2"]), "--out", str(out)]) == 3
        assert f"stcal: {out}: " in capsys.readouterr().err
