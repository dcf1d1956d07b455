"""``stcal camera convert`` does what the core does."""

import json

import numpy as np
import pytest
from conftest import ROOT

from stcal.calibration import load, sha256_of
from stcal.cameras import CAMERAS
from stcal.cli import main
from stcal.pipeline.conversion import convert_calibration

SAMPLE = ROOT / "sample_telemetry" / "truth" / "ST16-1.json"


def run(capsys, *arguments):
    """Exit code, standard output and standard error of a command."""
    code = main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_the_file_is_the_cores_result(capsys, tmp_path):
    out, report = tmp_path / "new.json", tmp_path / "new.html"
    code, printed, _ = run(
        capsys, "camera", "convert", SAMPLE, "--to", "pixel-radial", "--out", out, "--report",
        report, "--json",
    )  # fmt: skip
    assert code == 0
    expected = convert_calibration(load(SAMPLE), CAMERAS["pixel-radial"], sha256_of(SAMPLE))
    document = json.loads(printed)
    assert document == expected.document
    assert document["old"]["file"] == str(SAMPLE)
    assert load(out).to_json() == expected.calibration.to_json()
    assert load(out).provenance["converted_from_sha256"] == sha256_of(SAMPLE)
    assert "Conversion accepted" in report.read_text()


def test_its_document_makes_the_report_again(capsys, tmp_path):
    report, again = tmp_path / "a.html", tmp_path / "b.html"
    _, printed, _ = run(
        capsys, "camera", "convert", SAMPLE, "--to", "pixel-radial", "--out", tmp_path / "c.json",
        "--report", report, "--json",
    )  # fmt: skip
    (tmp_path / "conversion.json").write_text(printed)
    code, _, _ = run(capsys, "report", tmp_path / "conversion.json", "--out", again)
    assert code == 0
    assert again.read_bytes() == report.read_bytes()


def test_its_own_model_is_exact(capsys, tmp_path):
    out = tmp_path / "same.json"
    code, printed, _ = run(
        capsys, "camera", "convert", SAMPLE, "--to", "wang", "--out", out, "--maximum-urad", 0,
    )  # fmt: skip
    assert code == 0
    assert "Conversion accepted" in printed
    old, new = load(SAMPLE), load(out)
    assert np.array_equal(new.camera.parameters, old.camera.parameters)
    assert np.array_equal(new.c_sd, old.c_sd)
    assert new.serial == old.serial + 1


@pytest.mark.parametrize("as_json", [True, False])
def test_a_refused_conversion_ends_in_exit_4_and_writes_no_calibration(capsys, tmp_path, as_json):
    out, report = tmp_path / "new.json", tmp_path / "new.html"
    code, printed, err = run(
        capsys, "camera", "convert", SAMPLE, "--to", "pixel-radial", "--out", out, "--report",
        report, "--maximum-urad", 1, *(["--json"] if as_json else []),
    )  # fmt: skip
    assert code == 4
    assert "pixel-radial departs by" in err
    assert not out.exists()
    assert "Conversion refused" in report.read_text()
    if as_json:
        document = json.loads(printed)
        assert document["exit_code"] == 4
        assert document["errors"]["maximum_urad"] == 1.0
    else:
        assert "Conversion refused" in printed


def folded(tmp_path):
    document = json.loads(SAMPLE.read_text())
    document["camera"]["parameters"]["b2_per_m2"] = -1e5
    path = tmp_path / "folded.json"
    path.write_text(json.dumps(document))
    return path


BAD = [
    (["none.json", "--to", "wang", "--out", "O"], 3, "none.json"),
    ([SAMPLE, "--to", "fisheye", "--out", "O"], 2, "known: wang, pinhole-radial, pixel-radial"),
    ([SAMPLE, "--out", "O"], 2, "--to"),
    ([SAMPLE, "--to", "wang"], 2, "--out"),
    ([SAMPLE, "--to", "wang", "--out", SAMPLE], 2, "is the file to convert"),
    ([SAMPLE, "--to", "wang", "--out", SAMPLE / "x.json"], 3, "is not a folder"),
    ([SAMPLE, "--to", "wang", "--out", "O", "--report", SAMPLE / "x.html"], 3, "is not a folder"),
    ([SAMPLE, "--to", "wang", "--out", "O", "--maximum-urad", "-1"], 2, "--maximum-urad"),
    ([ROOT / "pyproject.toml", "--to", "wang", "--out", "O"], 3, "pyproject.toml: not JSON"),
    (["F", "--to", "wang", "--out", "O"], 3, "folded.json"),
]


@pytest.mark.parametrize(("arguments", "code", "message"), BAD)
def test_mistakes_get_a_message_and_their_exit_code(capsys, tmp_path, arguments, code, message):
    before = SAMPLE.read_bytes()
    places = {"O": tmp_path / "out.json", "F": folded(tmp_path)}
    given = [places.get(a, a) for a in arguments]
    found, out, err = run(capsys, "camera", "convert", *given)
    assert found == code
    assert message in err
    assert "Traceback" not in err
    assert out == ""
    assert not places["O"].exists()
    assert SAMPLE.read_bytes() == before
