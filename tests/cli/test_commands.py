"""Each command does what the core does, and ends in the exit codes of its help."""

import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from conftest import ROOT

from stcal.calibration import load
from stcal.cli import main

SAMPLE = ROOT / "sample_telemetry"
SENSOR = "ST16-4"
INITIAL = SAMPLE / f"{SENSOR}.initial.json"


def run(capsys, *arguments):
    """Exit code, standard output and standard error of a command."""
    code = main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.fixture(scope="module")
def work(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("work")
    for part in ("calibration", "validation"):
        code = main(
            ["ingest", str(SAMPLE / f"{SENSOR}.{part}.csv.gz"), "--store", str(folder / part),
             "--config", str(ROOT / "configs" / "st16.toml"), "--json"]
        )  # fmt: skip
        assert code == 0
    code = main(
        ["fit", "--batch", "--store", str(folder / "calibration"), "--sensor", SENSOR,
         "--initial", str(INITIAL), "--out", str(folder / "fit"), "--json"]
    )  # fmt: skip
    assert code == 0
    return folder


def test_fit_writes_the_calibration_that_its_document_describes(work):
    document = json.loads((work / "fit" / "fit.json").read_text())
    found = load(work / "fit" / "calibration.json")
    assert [p["fitted"] for p in document["parameters"]] == found.camera.parameters.tolist()
    assert found.serial == load(INITIAL).serial + 1
    assert set(found.provenance) >= {
        "telemetry_sha256", "catalogue_sha256", "config_sha256", "parent_sha256", "software",
        "from", "to",
    }  # fmt: skip
    truth = load(SAMPLE / "truth" / f"{SENSOR}.json").camera.parameters
    sd = np.sqrt(np.diag(found.covariance))
    assert (np.abs(found.camera.parameters - truth) < 4.5 * sd).all()
    assert "<html" in (work / "fit" / "report.html").read_text()


def test_fitting_twice_gives_the_same_calibration(work, capsys, tmp_path):
    code, out, _ = run(
        capsys, "fit", "--batch", "--store", work / "calibration", "--sensor", SENSOR,
        "--initial", INITIAL, "--out", tmp_path, "--workers", 2, "--json",
    )  # fmt: skip
    assert code == 0
    assert json.loads(out)["verdict"]["accepted"]
    again = (tmp_path / "calibration.json").read_bytes()
    assert again == (work / "fit" / "calibration.json").read_bytes()


def test_validate_prints_one_document_with_the_agreed_keys(work, capsys, tmp_path):
    code, out, _ = run(
        capsys, "validate", "--store", work / "validation", "--sensor", SENSOR, "--baseline",
        INITIAL, "--candidate", work / "fit" / "calibration.json", "--out", tmp_path, "--json",
    )  # fmt: skip
    assert code == 0
    document = json.loads(out)
    assert document["frames"] == 150
    for key in ("availability", "matched_stars", "common_pair_rms_urad"):
        assert set(document[key]) >= {"baseline", "candidate"}
    assert document["matched_star_ratio"] > 1.5
    assert document["pairs"] > 1000
    assert json.loads((tmp_path / "validation.json").read_text()) == document


def test_a_worse_candidate_ends_in_exit_4_with_the_document(work, capsys, tmp_path):
    code, out, err = run(
        capsys, "validate", "--store", work / "validation", "--sensor", SENSOR, "--baseline",
        work / "fit" / "calibration.json", "--candidate", INITIAL, "--out", tmp_path, "--json",
    )  # fmt: skip
    assert code == 4
    document = json.loads(out)
    assert not document["verdict"]["accepted"]
    assert document["exit_code"] == 4
    assert "refused" in err


def test_a_refused_fit_ends_in_exit_4_and_leaves_no_calibration(work, capsys, tmp_path):
    shutil.copy(work / "fit" / "calibration.json", tmp_path / "calibration.json")
    first = json.loads((work / "fit" / "fit.json").read_text())["span"]["from"]
    stop = first[:11] + "11:24:00Z"
    code, out, err = run(
        capsys, "fit", "--batch", "--store", work / "calibration", "--sensor", SENSOR,
        "--initial", INITIAL, "--out", tmp_path, "--to", stop, "--json",
    )  # fmt: skip
    assert code == 4
    assert "frames identified" in json.loads(out)["verdict"]["reasons"][0]
    assert "frames identified" in err
    assert not (tmp_path / "calibration.json").exists()
    assert (tmp_path / "report.html").exists()


def test_match_writes_one_row_per_star(work, capsys, tmp_path):
    code, out, _ = run(
        capsys, "match", "--store", work / "validation", "--sensor", SENSOR,
        "--calibration", work / "fit" / "calibration.json", "--out", tmp_path, "--json",
    )  # fmt: skip
    assert code == 0
    document = json.loads(out)
    table = pq.read_table(tmp_path / "matches.parquet")
    assert table.column_names == [
        "frame_id", "exposure", "row_px", "col_px", "star_id", "residual_urad",
    ]  # fmt: skip
    assert table.num_rows == document["stars"]
    named = np.array(table["star_id"].to_pylist()) != ""
    assert named.sum() == document["matched_stars"] > 3000
    residual = table["residual_urad"].to_pandas().to_numpy()
    assert np.isfinite(residual[named]).all()
    assert np.isnan(residual[~named]).all()
    attitudes = pq.read_table(tmp_path / "attitudes.parquet").to_pandas()
    fixed = attitudes["best_exposure"].notna()
    assert fixed.sum() == document["frames_solved"]
    quaternion = attitudes.loc[fixed, ["q_x", "q_y", "q_z", "q_w"]].to_numpy()
    np.testing.assert_allclose((quaternion**2).sum(axis=1), 1.0, atol=1e-12)
    sd = np.sqrt(attitudes.loc[fixed, "cov_zz_urad2"].to_numpy())
    across = np.sqrt(attitudes.loc[fixed, "cov_xx_urad2"].to_numpy())
    assert 5 < np.median(across) < 100
    assert np.median(sd / across) > 3
    assert attitudes.loc[~fixed, "cov_xx_urad2"].isna().all()


def test_tables_for_people(work, capsys, tmp_path):
    code, out, _ = run(
        capsys, "validate", "--store", work / "validation", "--sensor", SENSOR, "--baseline",
        INITIAL, "--candidate", work / "fit" / "calibration.json", "--out", tmp_path,
    )  # fmt: skip
    assert code == 0
    assert "Validation accepted" in out
    code, out, _ = run(capsys, "summary", tmp_path / "validation.json")
    assert code == 0
    assert SENSOR in out
    code, out, _ = run(
        capsys, "uplink", "diff", INITIAL, work / "fit" / "calibration.json", "--json"
    )
    assert code == 0
    assert json.loads(out)


BAD = [
    (["fit", "--store", "S", "--sensor", SENSOR, "--initial", INITIAL, "--out", "O"], 2, "--batch"),
    (["fit", "--batch", "--sensor", SENSOR, "--initial", INITIAL, "--out", "O"], 2, "--store"),
    (["fit", "--batch", "--store", "S", "--sensor", "ST16-9", "--initial", INITIAL, "--out", "O"],
     3, "ST16-9"),
    (["fit", "--batch", "--store", "nowhere", "--sensor", SENSOR, "--initial", INITIAL, "--out",
      "O"], 3, "nowhere"),
    (["fit", "--batch", "--store", "S", "--sensor", SENSOR, "--initial", "none.json", "--out",
      "O"], 3, "none.json"),
    (["fit", "--batch", "--store", "S", "--sensor", SENSOR, "--initial", INITIAL, "--out", "O",
      "--from", "yesterday"], 2, "--from"),
    (["fit", "--batch", "--store", "S", "--sensor", SENSOR, "--initial", INITIAL, "--out", "O",
      "--from", "2031-01-01"], 3, SENSOR),
    (["fit", "--batch", "--store", "S", "--sensor", SENSOR, "--initial", INITIAL, "--out", "O",
      "--config", ROOT / "configs" / "esa_tetra3.toml"], 3, "esa_tetra3"),
    (["fit", "--batch", "--store", "S", "--sensor", SENSOR, "--initial", INITIAL, "--out", "O",
      "--from", "2014-09-05", "--to", "2014-09-04"], 2, "not before"),
    (["fit", "--batch", "--store", "S", "--sensor", SENSOR, "--initial",
      SAMPLE / "ST16-2.initial.json", "--out", "O"], 3, "sensor ST16-2, not ST16-4"),
    (["validate", "--store", "S", "--sensor", SENSOR, "--baseline", INITIAL, "--candidate",
      SAMPLE / "ST16-3.initial.json", "--out", "O"], 3, "ST16-3.initial.json"),
    (["match", "--store", "S", "--sensor", SENSOR, "--calibration",
      SAMPLE / "ST16-3.initial.json", "--out", "O"], 3, "sensor ST16-3, not ST16-4"),
    (["fit", "--batch", "--store", "S", "--sensor", SENSOR, "--initial", INITIAL, "--out",
      INITIAL / "x"], 3, "cannot be made"),
    (["frobnicate"], 2, "frobnicate"),
]  # fmt: skip


@pytest.mark.parametrize(("arguments", "code", "message"), BAD)
def test_mistakes_get_a_message_and_their_exit_code(
    work, capsys, tmp_path, arguments, code, message
):
    places = {"S": work / "calibration", "O": tmp_path}
    found, out, err = run(capsys, *(places.get(a, a) for a in arguments))
    assert found == code
    assert message in err
    assert "Traceback" not in err
    assert out == ""


def test_a_calibration_for_another_detector_is_bad_input(work, capsys, tmp_path):
    document = json.loads(INITIAL.read_text())
    document["camera"]["rows"] = 1024
    other = tmp_path / "other.json"
    other.write_text(json.dumps(document))
    code, _, err = run(
        capsys, "fit", "--batch", "--store", work / "calibration", "--sensor", SENSOR,
        "--initial", other, "--out", tmp_path / "out",
    )  # fmt: skip
    assert code == 3
    assert "1024 x 2592" in err


def test_internal_errors_are_exit_1_without_a_traceback(capsys, monkeypatch, tmp_path):
    import stcal.config

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(stcal.config, "load_config", lambda path: 1 / 0)
    code, _, err = run(capsys, "sensor", "check", "x.toml")
    assert code == 1
    assert "internal error: ZeroDivisionError" in err
    assert "Traceback" not in err
    (kept,) = tmp_path.glob("stcal-crash-*.txt")
    assert "Traceback" in kept.read_text()


def test_interruption_is_exit_130(capsys, monkeypatch):
    import stcal.config

    def interrupt(path):
        raise KeyboardInterrupt

    monkeypatch.setattr(stcal.config, "load_config", interrupt)
    code, out, _ = run(capsys, "sensor", "check", "x.toml", "--json")
    assert code == 130
    assert json.loads(out)["exit_code"] == 130


def test_help_imports_nothing_heavy():
    script = (
        "import sys\nfrom stcal.cli import main\nmain(['--help'])\n"
        "heavy = {'numpy', 'scipy', 'numba', 'pyarrow', 'pandas', 'pydantic', 'matplotlib'}\n"
        "sys.exit(1 if heavy & set(sys.modules) else 0)\n"
    )
    start = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0
    assert "recalibrate" in done.stdout.lower()
    assert time.perf_counter() - start < 10
