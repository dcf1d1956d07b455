"""The study of Enright 2018: its document, the published values, and how findings are judged."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT

from stcal.cli import main
from stcal.simulate import load_scenario
from stcal.studies.enright import study_sensor
from stcal.studies.enright_filter_findings import frames_until
from stcal.studies.enright_findings import findings, most
from stcal.studies.enright_paper import SENSORS, published
from stcal.studies.findings import FAILS, HOLDS, OPEN, PARTLY, verdict_of
from stcal.studies.scenarios import shortened

SCENARIOS = ROOT / "configs" / "scenarios"
FILTERS = ("q", "no_q", "no_refit")
FRAMES = 60


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("enright")
    code = main(
        ["study", "enright", "--out", str(out), "--scenarios", str(SCENARIOS), "--sensors", "4,3",
         "--frames", str(FRAMES), "--workers", "2", "--json"]
    )  # fmt: skip
    assert code == 0
    return out


@pytest.fixture(scope="module")
def document(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "study.json").read_text())


def test_the_command_writes_document_and_report(folder: Path, document: dict[str, Any]) -> None:
    assert document["schema"] == "stcal.study.enright/1"
    assert document["sensor_id"] == "ST16-3, ST16-4"
    # Table VII's sensor was not run: another one stands in for it.
    assert document["shown"] == {
        "convergence": 4, "errors": 4, "radial": 3, "distortion": 3, "settling": 4,
    }  # fmt: skip
    assert "Table VII. Comparison of distortion parameters, Sensor 3" in (
        folder / "report.html"
    ).read_text(encoding="utf-8")


def test_the_document_is_complete(document: dict[str, Any]) -> None:
    full = ["batch", *FILTERS]
    for sensor in document["sensors"]:
        cameras = sensor["validation"]["cameras"]
        assert list(cameras) == ["raw", *full, *(f"{name}_reduced" for name in full), "true"]
        assert list(sensor["calibration"]["cameras"]) == ["raw", "batch"]
        figures = np.array([list(camera.values()) for camera in cameras.values()])
        assert np.isfinite(figures).all()
        assert len(sensor["parameters"]) == 8
        assert len(sensor["gates"]) == 11
        for start in ("lab", "batch"):
            for name in FILTERS:
                series = sensor["convergence"][start][name]
                assert len(series["departure"]) == len(sensor["convergence"]["frame"])
        assert sensor["errors"]["frame"][-1] == sensor["settling"]["frame"][-1] == FRAMES
        assert sensor["paper"] == json.loads(json.dumps(published(sensor["number"])))
    assert len(document["findings"]) == 9


def test_one_sensor_alone_gives_the_same_numbers(document: dict[str, Any]) -> None:
    scenario = shortened(load_scenario(SCENARIOS / "st16-3.toml"), FRAMES)
    alone = study_sensor(3, scenario, 1)
    assert json.loads(json.dumps(alone)) == document["sensors"][0]


def test_recalibration_reaches_the_true_camera(document: dict[str, Any]) -> None:
    for sensor in document["sensors"]:
        rms = {k: v["rms_urad"] for k, v in sensor["validation"]["cameras"].items()}
        assert rms["batch"] < 1.03 * rms["true"] < 0.2 * rms["raw"]
        assert rms["no_q"] < 1.03 * rms["true"]
        assert rms["batch_reduced"] > 1.5 * rms["batch"]
        assert sensor["nees"] < 4.0


def test_restarted_filters_start_from_the_batch_camera(document: dict[str, Any]) -> None:
    for sensor in document["sensors"]:
        batch = [row["fitted"]["batch"] for row in sensor["parameters"]]
        sigma = np.array([row["sigma"] for row in sensor["parameters"]])
        end = sensor["ends"]["no_refit"]
        # Kept matches: those of the batch camera lead back to it, the first camera's don't.
        far, near = (np.abs(np.array(end[k]) - batch) / sigma for k in ("lab", "batch"))
        assert near.max() < 0.5 * far.max()


def test_published_values_are_those_of_the_paper() -> None:
    first, second, sixth = published(1), published(2), published(6)
    assert first["change_sigma"]["f_m"] == -8.54
    assert sixth["change_sigma"]["n0_px"] == -9.81
    assert sixth["change_sigma"]["g_y"] == -1.30
    batch = published(4)["calibration"]["cameras"]["batch"]
    assert batch == {"availability": 1.00, "matched_star_ratio": 2.70, "rms_urad": 95.6}
    assert published(3)["calibration"]["cameras"]["raw"] == {"availability": 0.44, "rms_urad": 377}
    cameras = first["validation"]["cameras"]
    assert [cameras[k]["rms_urad"] for k in ("raw", "batch", *FILTERS)] == [
        385.3, 101.8, 108.0, 98.9, 93.5,
    ]  # fmt: skip
    assert cameras["batch_reduced"] == {"rms_urad": 175.6}
    assert cameras["no_refit_reduced"] == {"rms_urad": 103.3}
    kept = published(4)["validation"]["cameras"]["no_refit"]
    assert kept == {"rms_urad": 111.5, "matched_star_ratio": 0.88, "availability": 0.91}
    assert "batch_reduced" not in second["validation"]["cameras"]
    assert second["distortion"]["b4_per_m4"]["no_q"] == 0.320e8
    assert second["distortion"]["b2_per_m2"]["batch"] == -2.152e3
    assert first["distortion"] == {}


@pytest.mark.parametrize("sensor", SENSORS)
def test_scenarios_are_off_by_table_iii(sensor: int) -> None:
    scenario = load_scenario(SCENARIOS / f"st16-{sensor}.toml")
    assert scenario.camera.offset_sigma == published(sensor)["change_sigma"]


def with_rms(sensor: dict[str, Any], name: str, factor: float, part: str = "validation") -> None:
    sensor[part]["cameras"][name]["rms_urad"] *= factor


# Every change is made to both sensors of the run; the verdicts are before and after.
FLIPS = {
    "batch matches less": (0, PARTLY, FAILS, lambda s: s["calibration"]["cameras"]["batch"].update(
        matched_star_ratio=0.9)),
    "batch falls by half": (0, PARTLY, HOLDS, lambda s: s["calibration"]["cameras"]["batch"].update(
        rms_urad=0.5 * s["calibration"]["cameras"]["raw"]["rms_urad"])),
    "No-Q is worse": (1, HOLDS, FAILS, lambda s: with_rms(s, "no_q", 1.2)),
    "No-Refit is better": (2, HOLDS, FAILS, lambda s: with_rms(s, "no_refit", 0.5)),
    "Q is worse": (3, HOLDS, FAILS, lambda s: with_rms(s, "q", 1.2)),
    "reduced is a tenth worse": (4, FAILS, HOLDS, lambda s: s["validation"]["cameras"].update(
        batch_reduced={"rms_urad": 1.1 * s["validation"]["cameras"]["batch"]["rms_urad"]})),
    "No-Refit forgets too": (5, HOLDS, PARTLY, lambda s: s["ends"]["no_refit"].update(
        batch=s["ends"]["no_refit"]["lab"])),
    "Q overfits nothing": (6, HOLDS, FAILS, lambda s: s["errors"]["q"].update(
        aggregate_urad=s["errors"]["q"]["tail_urad"][-1])),
    "curves part at the boresight": (7, HOLDS, FAILS, lambda s: s["radial"].update(
        q=[v + 1.0 for v in s["radial"]["q"]])),
    "the error settles at once": (8, HOLDS, FAILS, lambda s: s["settling"].update(
        rms_urad=[100.0] * len(s["settling"]["frame"]))),
    "availability stays": (8, HOLDS, OPEN, lambda s: s["settling"].update(
        availability=[0.9] * len(s["settling"]["frame"]))),
}  # fmt: skip


@pytest.mark.parametrize("case", FLIPS)
def test_a_verdict_follows_the_numbers(case: str, document: dict[str, Any]) -> None:
    place, before, after, change = FLIPS[case]
    # What the short run leaves open is set to a clear case first.
    sensors = copy.deepcopy(document["sensors"])
    for sensor in sensors:
        clear(sensor)
    found = findings(sensors)
    assert found[place]["verdict"] == before
    for sensor in sensors:
        change(sensor)
    again = findings(sensors)
    assert again[place]["verdict"] == after
    assert again[place]["here"] != found[place]["here"]
    others = [k for k in range(9) if k != place]
    if place > 4:
        assert [again[k] for k in others] == [found[k] for k in others]


def clear(sensor: dict[str, Any]) -> None:
    """Give a sensor the histories of a long run: settled, and apart by filter."""
    sensor["settling"] = {
        "frame": [0, 1, 5, 60], "availability": [0.5, 0.98, 1.0, 1.0],
        "rms_urad": [400.0, 150.0, 95.0, 90.0],
    }  # fmt: skip
    for name, wander, shift in (("q", 3.0, 0.1), ("no_q", 1.0, 0.1), ("no_refit", 2.0, 4.0)):
        end = sensor["ends"][name]
        end["wander"] = [wander] * len(end["sd"])
        end["batch"] = [v + shift * sd for v, sd in zip(end["lab"], end["sd"], strict=True)]
    for name, aggregate in (("q", 0.97), ("no_q", 0.999)):
        errors = sensor["errors"][name]
        errors["aggregate_urad"] = aggregate * errors["tail_urad"][-1]


def test_missing_numbers_are_no_success(document: dict[str, Any]) -> None:
    sensors = copy.deepcopy(document["sensors"])
    for sensor in sensors:
        for camera in sensor["validation"]["cameras"].values():
            camera["rms_urad"] = None
    found = findings(sensors)
    assert [found[k]["verdict"] for k in (1, 2, 3, 4)] == [FAILS] * 4
    assert "not available" in found[1]["here"]


def test_verdict_of_shares() -> None:
    yes, no = True, False
    assert verdict_of(np.array([yes, yes])) == HOLDS
    assert verdict_of(np.array([yes, no])) == PARTLY
    assert verdict_of(np.array([yes, no, no])) == FAILS
    assert verdict_of(np.array([yes, no, no]), partly=True) == PARTLY
    assert verdict_of(np.array([], dtype=bool)) == OPEN
    assert [most(np.array(hits)) for hits in ([yes, yes, no], [yes, no], [no, no])] == [
        HOLDS, PARTLY, FAILS,
    ]  # fmt: skip


def test_frames_until_settled() -> None:
    sensor = {
        "settling": {
            "frame": [0, 1, 2, 5, 10],
            "availability": [0.5, 0.9, 0.96, 0.99, 1.0],
            "rms_urad": [500.0, 101.0, 140.0, 101.5, 100.0],
        }
    }
    assert frames_until(sensor, "availability") == 2
    # It was near before, but left again.
    assert frames_until(sensor, "rms_urad") == 5


@pytest.mark.parametrize("sensors", ["7", "1,1", "", "one"])
def test_wrong_sensors_are_refused(
    sensors: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["study", "enright", "--out", str(tmp_path), "--sensors", sensors]) == 2
    assert "--sensors" in capsys.readouterr().err


def test_a_missing_scenario_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--out", str(tmp_path), "--scenarios", str(tmp_path), "--sensors", "5", "--json"]
    assert main(["study", "enright", *arguments]) == 3
    captured = capsys.readouterr()
    assert "st16-5.toml" in json.loads(captured.out)["error"]
