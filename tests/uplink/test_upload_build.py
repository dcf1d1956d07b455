from __future__ import annotations

import copy
import csv
import json
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from sample_calibrations import (
    SD,
    WANG,
    fitted_document,
    parent_document,
    rotation_z,
    validation_document,
    write,
    write_pair,
)

from stcal.calibration import load, sha256_of
from stcal.cli import main
from stcal.errors import GateRefusalError
from stcal.report.upload_html import render
from stcal.uplink import build as building
from stcal.uplink import encode

Change = Callable[[dict[str, Any]], object]


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, dict[str, Any]]:
    code = main(["uplink", *map(str, arguments), "--json"])
    return code, json.loads(capsys.readouterr().out)


# Gates that need a store or a validation, which most tests here are not about.
APART = ("files", "fit-quality", "limits", "change", "validation", "held-out")


def build_command(
    new: Path, parent: Path, out: Path, *more: object, apart: tuple[str, ...] = APART
) -> list[object]:
    command = ["build", "--calibration", new, "--parent", parent, "--out", out, *more]
    for gate in apart:
        command += ["--override", gate, "--reason", "not under test"]
    return command


def build_upload(new: Path, parent: Path, out: Path, **evidence: Any) -> building.Built:
    overrides = dict.fromkeys(APART, "not under test")
    found = building.Evidence(**({"overrides": overrides} | evidence))
    return building.build(new, parent, out, found, render)


def test_build_writes_both_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    new, parent = write_pair(tmp_path, f_m=0.0159, b2_per_m2=-1234.5)
    code, document = run(capsys, *build_command(new, parent, tmp_path / "up"))
    assert code == 0
    folder = tmp_path / "up" / "serial-0002"
    assert Path(document["folder"]) == folder
    assert sorted(os.listdir(tmp_path / "up")) == ["serial-0002"]
    assert sorted(os.listdir(folder)) == [
        "calibration.json", "manifest.json", "parameters.csv", "report.html", "rollback",
    ]  # fmt: skip
    assert load(folder / "rollback" / "calibration.json").serial == 1
    assert document["sha256"]["calibration.json"] == sha256_of(folder / "calibration.json")
    again = load(folder / "calibration.json")
    assert again.camera.value("f_m") == 0.0159
    assert again.to_json() == load(new).to_json()


def test_table_carries_value_sd_and_change(tmp_path: Path) -> None:
    new, parent = write_pair(tmp_path, f_m=0.0159, b2_per_m2=-1234.5)
    folder = build_upload(new, parent, tmp_path / "up").folder
    with (folder / "parameters.csv").open(newline="") as stream:
        rows = {row["name"]: row for row in csv.DictReader(stream)}
    assert set(WANG) <= set(rows)
    assert rows["serial"]["value"] == "2"
    assert rows["serial"]["parent_value"] == "1"
    assert rows["sensor_id"]["value"] == "ST16-1"
    b2 = rows["b2_per_m2"]
    assert (b2["value"], b2["unit"], b2["sd"]) == ("-1234.5", "m^-2", "40.0")
    assert float(b2["change_sd"]) == pytest.approx(-1234.5 / 40.0)
    assert rows["f_m"]["unit"] == "m"
    assert float(rows["f_m"]["change"]) == pytest.approx(-1e-4)
    assert rows["g_y"]["unit"] == "1"
    assert float(rows["c_sd_21"]["value"]) == math.sin(1e-3)
    assert float(rows["c_sd_12"]["value"]) == -math.sin(1e-3)
    assert float(rows["c_sd_11"]["parent_value"]) == 1.0


def test_canonical_input_keeps_its_bytes(tmp_path: Path) -> None:
    new, parent = write_pair(tmp_path)
    new.write_bytes(encode.encode_calibration(load(new)))
    folder = build_upload(new, parent, tmp_path / "up").folder
    assert (folder / "calibration.json").read_bytes() == new.read_bytes()


def test_build_twice_is_the_same_and_other_content_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    new, parent = write_pair(tmp_path)
    assert not build_upload(new, parent, tmp_path / "up").existed
    assert build_upload(new, parent, tmp_path / "up").existed
    kept = (tmp_path / "up/serial-0002/calibration.json").read_bytes()
    write(new, fitted_document(sha256_of(parent), f_m=0.0161))
    code, document = run(capsys, *build_command(new, parent, tmp_path / "up"))
    assert code == 4
    assert "never overwritten" in document["error"]
    assert (tmp_path / "up/serial-0002/calibration.json").read_bytes() == kept
    assert os.listdir(tmp_path / "up") == ["serial-0002"]


def _set(*path: str | int, value: object) -> Change:
    def change(document: dict[str, Any]) -> None:
        place: Any = document
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = value

    return change


REFUSED: dict[str, tuple[Change, str]] = {
    "serial": (_set("serial", value=1), "serial 1 does not rise"),
    "lower serial": (_set("serial", value=0), "serial 0 does not rise"),
    "sensor": (_set("sensor_id", value="ST16-2"), "sensor_id is 'ST16-2'"),
    "unprintable": (_set("sensor_id", value="ST16\ud800"), "cannot be printed"),
    "rows": (_set("camera", "rows", value=1945), "camera.rows is 1945"),
    "cols": (_set("camera", "cols", value=2593), "camera.cols is 2593"),
    "pixel": (_set("camera", "pixel_size_m", value=2.3e-6), "pixel_size_m is 2.3e-06"),
    "nan": (_set("camera", "parameters", "f_m", value=math.nan), "parameters.f_m is nan"),
    "infinity": (_set("c_sd", 0, 1, value=math.inf), "c_sd[0][1] is inf"),
    "nan in quality": (_set("quality", "rms", value=math.nan), "quality.rms is nan"),
    "no covariance": (lambda d: d.pop("covariance"), "covariance is missing"),
    "variance": (_set("covariance", "matrix", 1, 1, value=-1.0), "variance of m0_px is -1.0"),
    "no provenance": (lambda d: d.pop("provenance"), "provenance.telemetry_sha256 is None"),
    "telemetry hash": (_set("provenance", "telemetry_sha256", value="?"), "not a SHA-256"),
    "catalogue hash": (
        lambda d: d["provenance"].pop("catalogue_sha256"),
        "provenance.catalogue_sha256 is None",
    ),
    "config hash": (
        lambda d: d["provenance"].pop("config_sha256"),
        "provenance.config_sha256 is None",
    ),
    "other parent": (_set("provenance", "parent_sha256", value="0" * 64), "the parent file's is"),
    "refused fit": (
        _set("quality", "verdict", value={"accepted": False, "reasons": ["too few frames"]}),
        "quality.verdict is not accepted: too few frames",
    ),
    "truthy verdict": (
        _set("quality", "verdict", value={"accepted": "false"}),
        "quality.verdict is not accepted",
    ),
    "no verdict": (lambda d: d.pop("quality"), "quality.verdict is missing"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_gate_refuses_and_leaves_nothing(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    new, parent = write_pair(tmp_path)
    document = json.loads(new.read_text())
    change, reason = REFUSED[name]
    change(document)
    write(new, document)
    code, answer = run(capsys, *build_command(new, parent, tmp_path / "up"))
    assert code == answer["exit_code"] == 4
    assert any(reason in line for line in answer["reasons"]), answer["reasons"]
    assert len(answer["reasons"]) == {"no provenance": 4, "unprintable": 2}.get(name, 1)
    assert sorted(os.listdir(tmp_path)) == ["new.json", "old.json"]


def test_other_camera_model_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from dataclasses import replace

    from stcal import calibration
    from stcal.cameras import CAMERAS
    from stcal.cameras.wang import WANG as MODEL

    other = {**CAMERAS, "other": replace(MODEL, name="other")}
    monkeypatch.setattr(calibration, "CAMERAS", other)
    new, parent = write_pair(tmp_path)
    document = json.loads(new.read_text())
    document["camera"]["model"] = "other"
    write(new, document)
    with pytest.raises(GateRefusalError, match=r"camera\.model is 'other'"):
        build_upload(new, parent, tmp_path / "up")
    assert not (tmp_path / "up").exists()


VALIDATIONS: dict[str, tuple[Change, str]] = {
    "refused": (_set("verdict", "accepted", value=False), "validation verdict is not accepted"),
    "no verdict": (lambda d: d.pop("verdict"), "validation verdict is missing"),
    "sensor": (_set("sensor_id", value="ST16-9"), "validation is of sensor 'ST16-9'"),
    "candidate": (_set("candidate", "sha256", value="0" * 64), "validation candidate.sha256"),
    "baseline": (lambda d: d.pop("baseline"), "validation baseline.sha256 is None"),
}


@pytest.mark.parametrize("name", VALIDATIONS)
def test_validation_must_be_accepted_and_belong(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    new, parent = write_pair(tmp_path)
    good = validation_document(sha256_of(new), sha256_of(parent))
    bad = copy.deepcopy(good)
    change, reason = VALIDATIONS[name]
    change(bad)
    path = tmp_path / "validation.json"
    write(path, bad)
    apart = tuple(gate for gate in APART if gate not in ("validation", "held-out"))
    more = ("--validation", path)
    command = build_command(new, parent, tmp_path / "up", *more, apart=apart)
    code, answer = run(capsys, *command)
    assert code == 4
    assert len(answer["reasons"]) == 1
    assert reason in answer["reasons"][0]
    assert not (tmp_path / "up").exists()
    write(path, good)
    code, answer = run(capsys, *command)
    assert code == 0
    assert answer["validation"] == str(path)


def test_all_reasons_at_once(tmp_path: Path) -> None:
    new, parent = write_pair(tmp_path)
    document = json.loads(new.read_text())
    document |= {"serial": 1, "sensor_id": "X", "quality": {}}
    write(new, document)
    with pytest.raises(GateRefusalError) as caught:
        build_upload(new, parent, tmp_path / "up")
    assert caught.value.document is not None
    assert len(caught.value.document["reasons"]) == 3


@pytest.mark.parametrize(
    ("name", "broken"),
    [
        ("encode_table", lambda content: content.replace(b"0.0159000001", b"0.0159")),
        ("encode_table", lambda content: content.replace(b"-0.00", b"0.00", 1)),
        ("encode_table", lambda content: content[: len(content) // 2]),
        ("encode_table", lambda content: content + content.splitlines(True)[-1]),
        ("encode_calibration", lambda content: content.replace(b"0.0159000001", b"0.0159")),
        ("encode_calibration", lambda content: content.replace(b'"serial": 2', b'"serial": 3')),
        ("encode_calibration", lambda content: content[:-10]),
    ],
)
def test_encoder_fault_is_refused(
    name: str,
    broken: Callable[[bytes], bytes],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    new, parent = write_pair(tmp_path, f_m=0.0159000001)
    right = getattr(encode, name)
    monkeypatch.setattr(encode, name, lambda *a: broken(right(*a)))
    code, answer = run(capsys, *build_command(new, parent, tmp_path / "up"))
    assert code == 4, answer
    assert not (tmp_path / "up").exists()


def test_failing_disk_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    new, parent = write_pair(tmp_path)
    right = building.write_bytes

    def full(path: Path, content: bytes) -> None:
        if path.name == encode.TABLE_FILE:
            raise OSError(28, "No space left on device")
        right(path, content)

    monkeypatch.setattr(building, "write_bytes", full)
    with pytest.raises(OSError, match="No space"):
        build_upload(new, parent, tmp_path / "up")
    assert os.listdir(tmp_path / "up") == []


@pytest.mark.parametrize("content", ["", "{", "[]", '{"schema": "stcal.calibration/1"}'])
def test_bad_file_is_bad_input(
    content: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    new, parent = write_pair(tmp_path)
    new.write_text(content)
    code, answer = run(capsys, *build_command(new, parent, tmp_path / "up"))
    assert code == 3
    assert str(new) in answer["error"]


def test_out_is_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    new, parent = write_pair(tmp_path)
    code, answer = run(capsys, *build_command(new, parent, parent))
    assert code == 3
    assert "not a directory" in answer["error"]


def test_held_parameter_needs_no_variance(tmp_path: Path) -> None:
    new, parent = write_pair(tmp_path)
    document = json.loads(new.read_text())
    document["covariance"]["matrix"][7][7] = 0.0
    write(new, document)
    build_upload(new, parent, tmp_path / "up")
    document["camera"]["parameters"]["g_y"] = 1.1
    write(new, document)
    with pytest.raises(GateRefusalError, match=r"variance of g_y is 0\.0"):
        build_upload(new, parent, tmp_path / "up2")


def test_samples_are_what_they_seem() -> None:
    assert parent_document()["c_sd"][0][0] == 1.0
    assert len(SD) == len(WANG)
    assert rotation_z(0.1)[1][0] > 0
