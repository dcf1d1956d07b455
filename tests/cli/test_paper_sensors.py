"""The sensors of Wu 2019 and Zhang 2024 through the whole line, by their TOML files alone."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT

from stcal.calibration import load
from stcal.cli import main

SENSORS = {"WU-1": "wu2019", "ZHANG-1": "zhang2024"}
SHOWN = {
    "WU-1": ("aspect", "f [mm]", "u0 [px]", "v0 [px]", "k1", "k2"),
    "ZHANG-1": ("x0 [px]", "y0 [px]", "f [mm]", "k1 [10⁻⁸ px⁻²]", "k2 [10⁻¹⁴ px⁻⁴]"),
}


def run(*arguments) -> int:
    return main([str(a) for a in arguments])


@pytest.fixture(scope="module", params=SENSORS)
def work(request, tmp_path_factory) -> Path:
    """A folder with both stores of a shortened scenario, named by the sensor."""
    sensor, name = request.param, SENSORS[request.param]
    folder = tmp_path_factory.mktemp(name) / sensor
    folder.mkdir()
    text = (ROOT / "configs" / "scenarios" / f"{name}.toml").read_text()
    text = text.replace("../", f"{ROOT}/configs/")
    text, count = re.subn(r"frames = (400|150)", lambda m: f"frames = {int(m[1]) * 2 // 5}", text)
    assert count == 2
    (folder / "scenario.toml").write_text(text)
    assert run("simulate", folder / "scenario.toml", "--out", folder, "--seed", 7, "--json") == 0
    config = ROOT / "configs" / f"{name}.toml"
    for part in ("calibration", "validation"):
        source = folder / f"{sensor}.{part}.csv.gz"
        assert run("ingest", source, "--store", folder / part, "--config", config, "--json") == 0
    return folder


@pytest.mark.parametrize("method", [["--batch"], ["--sequential", "sqrf"]], ids=["batch", "sqrf"])
def test_fit_and_validation_recover_the_true_camera(work, capsys, tmp_path, method):
    sensor, initial = work.name, work / f"{work.name}.initial.json"
    capsys.readouterr()
    code = run(
        "fit", *method, "--store", work / "calibration", "--sensor", sensor, "--initial", initial,
        "--out", tmp_path,
    )  # fmt: skip
    shown = capsys.readouterr().out
    assert code == 0
    for label in SHOWN[sensor]:
        assert f"\n {label} " in shown
        assert label in (tmp_path / "report.html").read_text()
    fitted, truth = load(tmp_path / "calibration.json"), load(work / "truth" / f"{sensor}.json")
    error = fitted.camera.parameters - truth.camera.parameters
    assert (np.abs(error) < 4.5 * np.sqrt(np.diag(fitted.covariance))).all()
    code = run(
        "validate", "--store", work / "validation", "--sensor", sensor, "--baseline", initial,
        "--candidate", tmp_path / "calibration.json", "--out", tmp_path / "v", "--json",
    )  # fmt: skip
    document = json.loads(capsys.readouterr().out)
    assert code == 0
    rms = document["common_pair_rms_urad"]
    assert rms["candidate"] < 0.5 * rms["baseline"]
    # 0.5 px of 181 urad, and 0.2 px of 243 urad, in both stars of a pair.
    noise = {"WU-1": 128.0, "ZHANG-1": 68.8}[sensor]
    assert rms["candidate"] == pytest.approx(noise, rel=0.06)
    assert run("uplink", "diff", initial, tmp_path / "calibration.json") == 0
    assert f"\n {SHOWN[sensor][-1]} " in capsys.readouterr().out
