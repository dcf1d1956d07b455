"""Each gate of an upload, overrides, the manifest, approval, and what flies."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT, st16_config
from sample_calibrations import fitted_document, parent_document, validation_document, write

from stcal.calibration import load, sha256_of
from stcal.cli import main
from stcal.errors import GateRefusalError, InputError
from stcal.report.upload_content import upload_verdict
from stcal.report.upload_html import render
from stcal.uplink.approve import approval_of, approve
from stcal.uplink.build import Built, Evidence, build
from stcal.uplink.crc import crc16_arc, shown
from stcal.uplink.gates import FIXED, GATES, Candidate, judge, refusals
from stcal.uplink.manifest import read_manifest
from stcal.uplink.on_board import compare_with_upload
from stcal.uplink.tables import Checked
from stcal.uplink.target import load_target
from stcal.uplink.verify import Difference

TARGET = ROOT / "configs" / "targets" / "st16_cfs.toml"
KEYS = ("telemetry_sha256", "catalogue_sha256", "config_sha256")


@pytest.fixture
def pair(tmp_path: Path) -> tuple[Path, Path, Path]:
    """A fitted calibration, its parent, and a validation of both, that pass every gate."""
    parent, new, validation = (tmp_path / f"{n}.json" for n in ("old", "new", "validation"))
    write(new, fitted_document(write(parent, parent_document()), f_m=0.01598))
    write(validation, validation_document(sha256_of(new), sha256_of(parent)))
    return new, parent, validation


def candidate_of(pair: tuple[Path, Path, Path]) -> Candidate:
    new, parent, validation = pair
    calibration = load(new)
    return Candidate(
        calibration, sha256_of(new), load(parent), sha256_of(parent),
        json.loads(validation.read_text()), st16_config(),
        {key: calibration.provenance[key] for key in KEYS},
    )  # fmt: skip


def test_a_good_candidate_passes_every_gate(pair: tuple[Path, Path, Path]) -> None:
    found = judge(candidate_of(pair))
    assert set(found) == set(GATES)
    assert refusals(found) == []
    assert found["change"].figures["sigma"]["f_m"] == pytest.approx(-2.5)
    assert found["change"].figures["turn_deg"] == pytest.approx(0.0573, abs=1e-4)
    assert found["held-out"].figures["fit"][0] == "2026-01-01T00:00:00.000Z"


def _quality(**changes: Any) -> Any:
    def change(candidate: Candidate) -> Candidate:
        calibration = candidate.calibration
        quality = {**calibration.quality, **changes}
        return replace(candidate, calibration=replace(calibration, quality=quality))

    return change


def _config(**changes: Any) -> Any:
    def change(candidate: Candidate) -> Candidate:
        assert candidate.config is not None
        uplink = candidate.config.uplink.model_copy(update=changes)
        return replace(candidate, config=candidate.config.model_copy(update={"uplink": uplink}))

    return change


def _span(first: str, last: str) -> Any:
    def change(candidate: Candidate) -> Candidate:
        assert candidate.validation is not None
        document = {**candidate.validation, "span": {"from": first, "to": last}}
        return replace(candidate, validation=document)

    return change


def _judged(**changes: Any) -> Any:
    def change(candidate: Candidate) -> Candidate:
        assert candidate.validation is not None
        return replace(candidate, validation={**candidate.validation, **changes})

    return change


def _covariance(i: int, j: int, correlation: float, both: bool = True) -> Any:
    """Set a correlation, of both its places or of one."""

    def change(candidate: Candidate) -> Candidate:
        matrix = np.array(candidate.calibration.covariance)
        matrix[i, j] = correlation * np.sqrt(matrix[i, i] * matrix[j, j])
        if both:
            matrix[j, i] = matrix[i, j]
        return replace(candidate, calibration=replace(candidate.calibration, covariance=matrix))

    return change


def _other_camera(candidate: Candidate) -> Candidate:
    from stcal.cameras import CAMERAS, Camera

    camera = Camera(CAMERAS["pixel-radial"], 1944, 2592, 2.2e-6, [971.5, 1295.5, 0.016, 0.0, 0.0])
    return replace(candidate, parent=replace(candidate.parent, camera=camera))


REFUSED: dict[str, tuple[Any, str, str]] = {
    "few frames": (_quality(frames=10), "fit-quality", "frames 10, at least 30 needed"),
    "few stars": (_quality(stars_used=10), "fit-quality", "stars 10, at least"),
    "coverage": (_quality(coverage=0.1), "fit-quality", "coverage 0.1, at least 0.5"),
    "condition": (
        _quality(condition={"scaled": 1e5}), "fit-quality", "condition 100000, at most 10000"
    ),
    "nothing known": (_quality(frames=None), "fit-quality", "says no frames"),
    "text for a number": (_quality(coverage="all"), "fit-quality", "says no coverage"),
    "limit": (_config(limits={"f_m": [0.0158, 0.0159]}), "limits", "f_m is 0.01598, allowed"),
    "change": (_config(maximum_change_sigma=1.0), "change", "f_m moves by -2.5 sigma, at most 1"),
    "turn": (_config(maximum_turn_deg=0.01), "change", "C_SD turns by 0.057 deg, at most 0.01"),
    "overlap": (
        _span("2026-01-01T12:00:00.000Z", "2026-01-05T00:00:00.000Z"), "held-out", "overlap"
    ),
    "touching": (
        _span("2026-01-02T00:00:00.000Z", "2026-01-05T00:00:00.000Z"), "held-out", "overlap"
    ),
    "touching within a millisecond": (
        _span("2026-01-01T23:59:59.999999999Z", "2026-01-05T00:00:00.000Z"), "held-out", "overlap"
    ),
    "times of another zone": (
        _span("2026-01-05T00:00:00+02:00", "2026-01-06T00:00:00+02:00"), "held-out", "not both"
    ),
    "no times": (_span("zzz", "zzz"), "held-out", "not both known"),
    "span turned round": (
        _span("2026-01-04T00:00:00.000Z", "2026-01-03T00:00:00.000Z"), "held-out", "not both"
    ),
    "telemetry of the fit": (
        _judged(provenance={"telemetry_sha256": "d" * 64}), "held-out", "read the telemetry of the"
    ),
    "availability": (
        _judged(availability={"interval": {"baseline": [0.9, 1.0], "candidate": [0.5, 0.8]}}),
        "validation", "availability 0.5 to 0.8 is worse than the parent's 0.9 to 1",
    ),
    "matched stars": (
        _judged(matched_star_ratio_interval=[0.9, 0.99]), "validation", "ratio is 0.9 to 0.99"
    ),
    "common pairs": (
        _judged(rms_ratio_interval=[1.02, 1.1]), "validation", "common pairs is 1.02 to 1.1"
    ),
    "no availability": (_judged(availability=None), "validation", "no intervals of availability"),
    "no matched stars": (
        _judged(matched_star_ratio_interval=[None, None]), "validation", "no interval of matched"
    ),
    "no common pairs": (_judged(rms_ratio_interval=None), "validation", "no interval of rms_ratio"),
    "interval turned round": (_judged(rms_ratio_interval=[0.2, 0.1]), "validation", "no interval"),
    "covariance with a loop": (_covariance(0, 1, 2.0), "covariance", "has the eigenvalue -1"),
    "covariance askew": (_covariance(0, 1, 0.5, both=False), "covariance", "not symmetric"),
    "frames beyond a float": (_quality(frames=10**400), "fit-quality", "says no frames"),
    "no span": (lambda c: replace(c, validation={}), "held-out", "not both known"),
    "no validation": (lambda c: replace(c, validation=None), "validation", "no --validation"),
    "no store": (lambda c: replace(c, on_disk=None), "files", "no --store"),
    "no configuration": (lambda c: replace(c, config=None), "limits", "no --store"),
    "other telemetry": (
        lambda c: replace(c, on_disk={**c.on_disk, "telemetry_sha256": "f" * 64}), "files",
        "telemetry_sha256 of the fit is",
    ),
    "something else on board": (
        lambda c: replace(c, readback=[Difference("focal_length", 8, "16.0", "15.9")]),
        "on-board", "on board, focal_length is 15.9, the parent has 16.0",
    ),
    "table": (lambda c: replace(c, table=Checked(["rounding costs too much"])), "table", "costs"),
    "camera model": (_other_camera, "identity", "camera.model is 'wang'"),
    "change between models": (_other_camera, "change", "different camera models"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_a_gate_refuses_and_can_be_overridden(name: str, pair: tuple[Path, Path, Path]) -> None:
    change, gate, reason = REFUSED[name]
    found = judge(change(candidate_of(pair)))
    told = refusals(found)
    assert any(line.startswith(f"{gate}: ") and reason in line for line in told), told
    assert not [line for line in refusals(found, [gate]) if line.startswith(f"{gate}: ")]


@pytest.mark.parametrize(
    "change",
    [
        _judged(rms_ratio_interval=[0.9, 1.1], matched_star_ratio_interval=[0.9, 1.1]),
        _judged(availability={"interval": {"baseline": [0.8, 1.0], "candidate": [0.7, 0.9]}}),
        # Nothing to divide by where the parent matches no star.
        _judged(
            matched_stars={"baseline": 0, "candidate": 9}, matched_star_ratio_interval=[None, None]
        ),
        _span("2026-01-02T00:00:00.000000001Z", "2026-01-05T00:00:00.000Z"),
        _covariance(0, 1, 0.999),
    ],
)
def test_what_is_not_worse_passes(change: Any, pair: tuple[Path, Path, Path]) -> None:
    assert refusals(judge(change(candidate_of(pair)))) == []


@pytest.mark.parametrize("which", [1, 2])
def test_nan_of_any_input_is_refused(
    which: int, pair: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    document = json.loads(pair[which].read_text())
    write(pair[which], {**document, "quality": {"rms": float("nan")}})
    with pytest.raises(GateRefusalError, match=r"(parent|validation): quality\.rms is nan"):
        built(pair, tmp_path / "up")
    assert not (tmp_path / "up").exists()


def test_gates_never_raise_on_a_bare_calibration(pair: tuple[Path, Path, Path]) -> None:
    new, parent, _ = pair
    bare = replace(load(parent), serial=7)
    found = judge(Candidate(bare, "0" * 64, load(parent), sha256_of(parent), {"span": 3}))
    assert {name for name in found if found[name].reasons} >= {
        "covariance", "provenance", "files", "fit-verdict", "fit-quality", "validation", "held-out",
    }  # fmt: skip
    assert new.exists()


def built(pair: tuple[Path, Path, Path], out: Path, **evidence: Any) -> Built:
    candidate = candidate_of(pair)
    given = {
        "validation": candidate.validation, "config": candidate.config,
        "on_disk": candidate.on_disk, "target": (load_target(TARGET), TARGET.read_bytes()),
    }  # fmt: skip
    return build(pair[0], pair[1], out, Evidence(**(given | evidence)), render)


def test_the_directory_of_an_upload(pair: tuple[Path, Path, Path], tmp_path: Path) -> None:
    found = built(pair, tmp_path / "up")
    folder = tmp_path / "up" / "serial-0002"
    names = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    assert names - {"manifest.json"} == set(found.manifest["files"])
    assert {"calibration.json", "parameters.csv", "target.toml", "report.html"} <= names
    for ending in (".tbl", ".dat", ".ycs"):
        own = [n for n in names if n.endswith(ending) and "/" not in n]
        assert len(own) == 1
        assert f"rollback/{own[0]}" in names
    document = read_manifest(folder)
    assert document == json.loads(json.dumps(found.manifest))
    assert document["parent"] == {"serial": 1, "sha256": sha256_of(pair[1])}
    assert document["data"]["fit"]["from"] == "2026-01-01T00:00:00.000Z"
    assert all(gate["passed"] for gate in document["gates"].values())
    table = next(n for n in names if n.endswith(".tbl") and "/" not in n)
    payload = (folder / table).read_bytes()[-144:]
    assert document["crc16_arc"][table] == shown(crc16_arc(payload))
    page = (folder / "report.html").read_text()
    assert "focal_length" in page
    assert document["files"][table]["sha256"] in page
    again = built(pair, tmp_path / "again")
    assert (again.folder / "manifest.json").read_bytes() == (folder / "manifest.json").read_bytes()


def test_the_rollback_is_the_parent(pair: tuple[Path, Path, Path], tmp_path: Path) -> None:
    folder = built(pair, tmp_path / "up").folder
    assert load(folder / "rollback" / "calibration.json").to_json() == load(pair[1]).to_json()
    table = next((folder / "rollback").glob("*.tbl"))
    found = compare_with_upload(folder, table.read_bytes(), None)
    assert {d.field for d in found} >= {"serial", "focal_length", "alignment_12"}


def test_overrides_are_recorded_and_shown(pair: tuple[Path, Path, Path], tmp_path: Path) -> None:
    with pytest.raises(GateRefusalError) as caught:
        built(pair, tmp_path / "up", on_disk=None)
    assert caught.value.document is not None
    assert not caught.value.document["gates"]["files"]["passed"]
    assert not (tmp_path / "up").exists()
    found = built(pair, tmp_path / "up", on_disk=None, overrides={"files": "archive is offline"})
    assert found.manifest["overrides"] == {"files": "archive is offline"}
    assert found.manifest["gates"]["files"]["override"] == "archive is offline"
    assert "archive is offline" in (found.folder / "report.html").read_text()


def test_an_override_that_was_not_needed_is_told_as_such(
    pair: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    found = built(pair, tmp_path / "up", overrides={"limits": "as a precaution"})
    assert found.manifest["overrides"] == {"limits": "as a precaution"}
    notes = upload_verdict(found.manifest).notes
    assert notes == ("gate limits passed, its override was not needed: as a precaution",)
    found = built(pair, tmp_path / "up2", on_disk=None, overrides={"files": "offline"})
    assert upload_verdict(found.manifest).notes == ("gate files overridden: offline",)


def test_a_readback_must_hold_the_parent(pair: tuple[Path, Path, Path], tmp_path: Path) -> None:
    first = built(pair, tmp_path / "up").folder
    dump = next((first / "rollback").glob("*.tbl")).read_bytes()
    found = built(pair, tmp_path / "up2", readback=dump)
    assert found.manifest["gates"]["on-board"]["figures"] == {"compared": True}
    damaged = bytearray(dump)
    damaged[-136] ^= 0x10
    with pytest.raises(GateRefusalError, match="on board, "):
        built(pair, tmp_path / "up3", readback=bytes(damaged))
    with pytest.raises(InputError):
        built(pair, tmp_path / "up3", readback=b"")


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, dict[str, Any]]:
    code = main(["uplink", *map(str, arguments), "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_approval_binds_a_name_to_the_manifest(
    pair: tuple[Path, Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = built(pair, tmp_path / "up").folder
    code, found = run(capsys, "approve", folder, "--name", "A. Turner", "--time",
                      "2026-03-01T10:00:00Z")  # fmt: skip
    assert code == 0
    assert found["manifest_sha256"] == sha256_of(folder / "manifest.json")
    assert approval_of(folder).name == "A. Turner"  # type: ignore[union-attr]
    assert approve(folder, "A. Turner", "2026-03-02T10:00:00.000Z").time_utc == found["time_utc"]
    with pytest.raises(GateRefusalError, match=r"approved by A\. Turner"):
        approve(folder, "B. Smith", "2026-03-02T10:00:00.000Z")
    assert run(capsys, "approve", folder, "--name", " ")[0] == 3
    assert run(capsys, "approve", folder, "--name", "C", "--time", "noon")[0] == 2


def test_a_changed_file_is_not_approved(
    pair: tuple[Path, Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = built(pair, tmp_path / "up").folder
    for name in ("calibration.json", "rollback/calibration.json", "report.html"):
        other = tmp_path / "copy"
        shutil.copytree(folder, other)
        (other / name).write_bytes((other / name).read_bytes() + b" ")
        code, found = run(capsys, "approve", other, "--name", "A")
        assert code == 3
        assert name in found["error"]
        assert not (other / "approval.json").exists()
        (other / name).unlink()
        assert run(capsys, "approve", other, "--name", "A")[0] == 3
        shutil.rmtree(other)
    assert run(capsys, "approve", tmp_path / "nothing", "--name", "A")[0] == 3


def test_what_the_manifest_does_not_name_is_not_approved(
    pair: tuple[Path, Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = built(pair, tmp_path / "up").folder
    (folder / "rollback" / "other.tbl").write_bytes(b"other")
    code, found = run(capsys, "approve", folder, "--name", "A")
    assert code == 3
    assert "rollback/other.tbl: is not in the manifest" in found["error"]
    (folder / "rollback" / "other.tbl").unlink()
    document = json.loads((folder / "manifest.json").read_text())
    for files in ({}, {**document["files"], "a\0b": {"sha256": ""}}):
        write(folder / "manifest.json", {**document, "files": files})
        assert run(capsys, "approve", folder, "--name", "A")[0] == 3
    write(folder / "manifest.json", document)
    assert run(capsys, "approve", folder, "--name", "A")[0] == 0
    assert run(capsys, "approve", folder, "--name", "A")[0] == 0


def test_verify_names_the_first_field_that_differs(
    pair: tuple[Path, Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = built(pair, tmp_path / "up").folder
    table = next(folder.glob("*.tbl"))
    assert run(capsys, "verify", folder, table)[0] == 0
    dump = bytearray(table.read_bytes()[-144:])
    (tmp_path / "dump.bin").write_bytes(dump)
    assert run(capsys, "verify", folder, tmp_path / "dump.bin")[0] == 0
    dump[9] ^= 1
    (tmp_path / "dump.bin").write_bytes(dump)
    code, found = run(capsys, "verify", folder, tmp_path / "dump.bin")
    assert code == 4
    assert [d["field"] for d in found["differences"]] == ["focal_length"]
    assert run(capsys, "verify", folder, next(folder.glob("*.dat")))[0] == 0
    crc = read_manifest(folder)["crc16_arc"][table.name]
    assert run(capsys, "verify", folder, "--crc", crc)[0] == 0
    wrong = f"{int(crc, 16) ^ 1:#06x}"
    code, found = run(capsys, "verify", folder, "--crc", wrong)
    assert code == 4
    assert found["differences"][0]["field"] == "CRC-16/ARC"
    for options in ([], ["--crc", "xyz"], ["--crc", "123456"], [table, "--crc", crc]):
        assert run(capsys, "verify", folder, *options)[0] == 2
    (tmp_path / "empty").write_bytes(b"")
    assert run(capsys, "verify", folder, tmp_path / "empty")[0] == 3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--override", "files"], "one for each"),
        (["--reason", "x"], "one for each"),
        (["--override", "luck", "--reason", "x"], "'luck' is not a gate"),
        (["--override", "files", "--reason", " "], "says nothing"),
        (["--override", "files", "--reason", "x", "--override", "files", "--reason", "y"], "twice"),
        (["--readback", TARGET], "--readback needs --target"),
        *((["--override", gate, "--reason", "x"], "cannot be overridden") for gate in FIXED),
    ],
)
def test_senseless_options_are_usage_errors(
    options: list[object], message: str, pair: tuple[Path, Path, Path], tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    new, parent, _ = pair
    arguments = ["build", "--calibration", new, "--parent", parent, "--out", tmp_path / "up"]
    code, found = run(capsys, *arguments, *options)
    assert code == 2
    assert message in found["error"]
    assert "up" not in os.listdir(tmp_path)
