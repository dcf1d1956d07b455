"""The files of a simulation and the command that writes them."""

import csv
import gzip
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stcal.calibration import load
from stcal.catalog import identifiers
from stcal.cli import main
from stcal.simulate import load_scenario, scenario_with, simulate
from stcal.simulate.attitude import mounting_rotation
from stcal.simulate.files import summary, write_simulation
from stcal.telemetry.attitudes import read_attitudes
from stcal.times import parse_utc

ROOT = Path(__file__).parents[2]
SCENARIO = ROOT / "configs" / "scenarios" / "st16-5.toml"
SAMPLES = ROOT / "sample_telemetry"


@pytest.fixture(scope="module")
def simulation():
    return simulate(
        scenario_with(
            load_scenario(SCENARIO),
            calibration__segments__0__frames=30,
            validation__segments__0__frames=12,
            detection__limiting_magnitude=3.0,  # leaves exposures and frames without stars
            detection__false_stars_per_exposure=0.0,
        ),
        3,
    )


def _rows(path):
    with gzip.open(path, "rt") as stream:
        return list(csv.DictReader(stream))


def test_csv_says_what_the_frames_say(simulation, tmp_path):
    files = write_simulation(simulation, tmp_path)
    frames = simulation.calibration.frames
    rows = _rows(files["calibration telemetry"])
    per_frame = frames.stars_per_exposure.reshape(-1, 2).sum(axis=1)
    assert (per_frame == 0).any()
    assert len(rows) == np.maximum(per_frame, 1).sum()
    stars = [row for row in rows if row["exposure"]]
    np.testing.assert_array_equal([float(r["row_px"]) for r in stars], frames.row_px)
    np.testing.assert_array_equal([float(r["col_px"]) for r in stars], frames.col_px)
    np.testing.assert_array_equal([float(r["intensity"]) for r in stars], frames.intensity)
    codes = identifiers.encode(np.array([r["star_id"] for r in stars], dtype=object))
    np.testing.assert_array_equal(codes, frames.star_id)
    first = {int(row["frame_id"]): row for row in reversed(rows)}
    np.testing.assert_array_equal(sorted(first), frames.frame_id)
    for index, number in enumerate(frames.frame_id.tolist()):
        row = first[number]
        assert parse_utc(row["time_utc"]) == frames.t_tai_ns[index]
        q = [float(row[f"q_{axis}"]) if row[f"q_{axis}"] else np.nan for axis in "xyzw"]
        np.testing.assert_array_equal(q, frames.q_si[index])
        position = [float(row[f"pos_{axis}_km"]) for axis in "xyz"]
        np.testing.assert_array_equal(position, frames.pos_km[index])


def test_calibrations_and_truth_read_back(simulation, tmp_path):
    files = write_simulation(simulation, tmp_path)
    for name, expected in (("initial", simulation.initial), ("true", simulation.true)):
        read = load(files[f"{name} calibration"])
        np.testing.assert_array_equal(read.camera.parameters, expected.camera.parameters)
        np.testing.assert_array_equal(read.c_sd, expected.c_sd)
    with np.load(files["truth"]) as truth:
        np.testing.assert_array_equal(
            truth["validation.star_id"], simulation.validation.truth.star_id
        )
        np.testing.assert_array_equal(truth["calibration.q_si"], simulation.calibration.truth.q_si)
        assert len(truth["calibration.frame_id"]) == 30
    assert "truth" not in write_simulation(simulation, tmp_path / "lean", truth_columns=False)
    assert not list((tmp_path / "lean").rglob("*.npz"))


def test_body_attitude_reads_back_with_its_noise(simulation, tmp_path):
    path = write_simulation(simulation, tmp_path)["body attitude"]
    body = read_attitudes(path)
    assert len(body.t_tai_ns) == 42
    sd = np.sqrt(np.diagonal(body.covariance, axis1=1, axis2=2))
    np.testing.assert_allclose(sd, 30e-6)
    parts = (simulation.calibration, simulation.validation)
    times = np.concatenate([part.frames.t_tai_ns for part in parts])
    q_si = np.concatenate([part.truth.q_si[::2] for part in parts])[np.argsort(times)]
    c_bs = Rotation.from_quat(body.q_bi).inv() * Rotation.from_quat(q_si)
    turn = (c_bs * mounting_rotation(simulation.scenario.mounting).inv()).as_rotvec()
    np.testing.assert_allclose(turn.std(), 30e-6, rtol=0.25)
    assert np.abs(turn.mean(axis=0)).max() < 4 * 30e-6 / np.sqrt(42)


def test_first_pixel_convention_reaches_the_file(simulation, tmp_path):
    sensor = simulation.scenario.sensor
    detector = sensor.detector.model_copy(update={"first_pixel_centre_px": 0.5})
    moved = scenario_with(
        simulation.scenario, sensor=sensor.model_copy(update={"detector": detector})
    )
    plain = write_simulation(simulation, tmp_path / "a")
    shifted = write_simulation(simulate(moved, 3), tmp_path / "b")
    for a, b in zip(
        _rows(plain["validation telemetry"]), _rows(shifted["validation telemetry"]), strict=True
    ):
        if a["row_px"]:
            assert float(b["row_px"]) - float(a["row_px"]) == pytest.approx(0.5, abs=1e-9)


def test_summary_counts(simulation):
    counted = summary(simulation)["calibration"]
    part = simulation.calibration
    assert counted["frames"] == 30
    assert counted["stars"] == part.frames.n_stars == len(part.truth.star_id)
    assert counted["false_stars"] == 0
    assert counted["outliers"] == part.truth.outlier.sum()
    counts = part.frames.counts_for_availability
    share = part.frames.has_fix[counts].sum() / counts.sum()
    assert counted["availability"] == pytest.approx(share, abs=1e-6)


def _small(tmp_path):
    text = SCENARIO.read_text().replace("../st16.toml", str(ROOT / "configs" / "st16.toml"))
    text = text.replace("frames = 400", "frames = 25").replace("frames = 150", "frames = 10")
    path = tmp_path / "small.toml"
    path.write_text(text)
    return path


def test_command_equals_the_core_and_repeats_its_bytes(tmp_path, capsys):
    path = _small(tmp_path)
    assert main(["simulate", str(path), "--out", str(tmp_path / "a"), "--seed", "7", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    expected = simulate(load_scenario(path), 7)
    assert document["parts"] == summary(expected)
    write_simulation(expected, tmp_path / "b")
    made = sorted(p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*.*"))
    assert len(made) == 6
    for name in made:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    assert main(["simulate", str(path), "--out", str(tmp_path / "a"), "--seed", "8"]) == 0
    human = capsys.readouterr().out
    assert "ST16-5, seed 8" in human
    telemetry = "ST16-5.calibration.csv.gz"
    assert (tmp_path / "a" / telemetry).read_bytes() != (tmp_path / "b" / telemetry).read_bytes()


def test_bytes_repeat_in_another_process(tmp_path):
    path = _small(tmp_path)
    write_simulation(simulate(load_scenario(path), 7), tmp_path / "here")
    command = [sys.executable, "-m", "stcal", "simulate", str(path), "--seed", "7"]
    subprocess.run([*command, "--out", str(tmp_path / "there")], check=True, capture_output=True)
    for one in (tmp_path / "here").rglob("*.*"):
        other = tmp_path / "there" / one.relative_to(tmp_path / "here")
        assert one.read_bytes() == other.read_bytes()


@pytest.mark.parametrize(
    ("arguments", "code", "told"),
    [
        (["missing.toml", "--out", "x"], 3, "cannot be read"),
        (["{scenario}", "--out", "x", "--seed", "-1"], 2, "seed"),
        (["{scenario}"], 2, "--out"),
    ],
)
def test_command_errors(tmp_path, capsys, monkeypatch, arguments, code, told):
    monkeypatch.chdir(tmp_path)
    arguments = [a.format(scenario=_small(tmp_path)) for a in arguments]
    assert main(["simulate", *arguments, "--json"]) == code
    out = json.loads(capsys.readouterr().out)
    assert told in out["error"]
    assert out["exit_code"] == code


@pytest.mark.skipif(not SAMPLES.is_dir(), reason="sample_telemetry is not part of this copy")
def test_sample_telemetry_is_what_its_scenarios_make():
    """Measured columns; the sensor's matches change as the matcher does."""
    scenario = load_scenario(SCENARIO)
    frames = simulate(scenario, 1).validation.frames
    rows = _rows(SAMPLES / "ST16-5.validation.csv.gz")
    stars = [row for row in rows if row["exposure"]]
    # Libraries of mathematics may differ in the last digit.
    np.testing.assert_allclose([float(r["row_px"]) for r in stars], frames.row_px, atol=0.0011)
    np.testing.assert_allclose([float(r["col_px"]) for r in stars], frames.col_px, atol=0.0011)
    shipped = {path.name for path in SAMPLES.iterdir()}
    for number in range(1, 7):
        for kind in ("calibration.csv.gz", "validation.csv.gz", "initial.json"):
            assert f"ST16-{number}.{kind}" in shipped
        load(SAMPLES / "truth" / f"ST16-{number}.json")
        read_attitudes(SAMPLES / "body" / f"ST16-{number}.csv.gz")
    assert sum(path.stat().st_size for path in SAMPLES.rglob("*.*")) < 5_000_000
