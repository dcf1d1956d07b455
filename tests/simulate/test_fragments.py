"""A simulation in fragments: the telemetry of the one in memory, a file a day, any order."""

import csv
import gzip
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stcal.cli import main
from stcal.errors import InputError
from stcal.frames import concatenate
from stcal.simulate import fragments, load_scenario, scenario_with, simulate, with_frames
from stcal.simulate.attitude import mounting_rotation
from stcal.simulate.files import summary, write_simulation
from stcal.simulate.fragments import Output, lay_out, simulate_fragment, write_fragments
from stcal.telemetry.attitudes import read_attitudes
from stcal.telemetry.packet_layout import load_layout

ROOT = Path(__file__).parents[2]
LAYOUT = ROOT / "configs" / "packets" / "st16.toml"


@pytest.fixture(scope="module")
def scenario():
    """Frames on three days: a chunk of 256 frames reaches over a day's end."""
    whole = load_scenario(ROOT / "configs" / "scenarios" / "st16-1.toml")
    return scenario_with(
        whole,
        epoch="2014-02-10T22:00:00Z",
        calibration__sample_period_s=300.0,
        calibration__segments__0__frames=330,
        validation__segments__0__frames=5,
        visibility__keep_flagged=1.0,
    )


def _lines(path):
    with gzip.open(path, "rt") as stream:
        return stream.read().splitlines()


def test_fragments_join_to_the_simulation_in_memory(scenario, tmp_path):
    made = simulate(scenario, 3)
    whole = write_simulation(made, tmp_path / "whole")
    told = write_fragments(lay_out(scenario, 3), Output(tmp_path / "days"))
    days = sorted((tmp_path / "days" / "calibration").iterdir())
    assert [path.name for path in days] == [
        f"ST16-1.calibration.2014-02-{day}.csv.gz" for day in (10, 11, 12)
    ]
    joined = [line for path in days for line in _lines(path)[1:]]
    assert joined == _lines(whole["calibration telemetry"])[1:]
    for path in days:
        rows = list(csv.DictReader(_lines(path)))
        assert {row["time_utc"][:10] for row in rows} == {path.name.split(".")[2]}
    for part, figures in summary(made).items():
        assert {key: told["parts"][part][key] for key in figures} == figures
    for name in ("initial calibration", "true calibration"):
        assert told["files"][name].read_bytes() == whole[name].read_bytes()
    _check_truth(tmp_path / "days" / "truth", made)


def _check_truth(folder, made):
    """The truth of every day, and the body's attitude, belong to its frames."""
    for column in ("frame_id", "q_si", "parameters", "star_id"):
        pieces = []
        for path in sorted(folder.glob("ST16-1.calibration.*.npz")):
            with np.load(path) as truth:
                pieces.append(truth[column])
        owner = made.calibration.frames if column == "frame_id" else made.calibration.truth
        np.testing.assert_array_equal(np.concatenate(pieces), getattr(owner, column))
    body = sorted((folder.parent / "body").glob("ST16-1.calibration.*"))
    records = [read_attitudes(path) for path in body]
    times = np.concatenate([record.t_tai_ns for record in records])
    np.testing.assert_array_equal(times, made.calibration.frames.t_tai_ns)
    noise = _body_noise(made, records)
    starts = np.cumsum([0, *(len(record.t_tai_ns) for record in records[:-1])])
    assert np.ptp(noise[starts], axis=0).min() > 1e-6  # each day has noise of its own
    assert 25e-6 < noise.std() < 35e-6


def _body_noise(made, records):
    q_bi = np.concatenate([record.q_bi for record in records])
    q_si = made.calibration.truth.q_si[::2]
    c_bs = Rotation.from_quat(q_bi).inv() * Rotation.from_quat(q_si)
    return (c_bs * mounting_rotation(made.scenario.mounting).inv()).as_rotvec()


def test_long_days_are_cut(scenario, monkeypatch):
    monkeypatch.setattr(fragments, "MAXIMUM_FRAMES", 100)
    plan = lay_out(scenario, 3)
    world, parts = plan.parts[0]
    assert [one.label for one in parts] == [
        "2014-02-10",
        *(f"2014-02-11.00{k}" for k in (1, 2, 3)),
        "2014-02-12",
    ]
    assert all(one.stop - one.start <= 100 for one in parts)
    pieces = [piece.frames for one in parts for piece in simulate_fragment(world, one)]
    np.testing.assert_array_equal(concatenate(pieces).frame_id, np.arange(1, 331))


def test_command_makes_the_same_files_with_any_number_of_workers(tmp_path, capsys):
    text = (ROOT / "configs" / "scenarios" / "st16-year.toml").read_text()
    assert "3_150_000" in text
    path = tmp_path / "year.toml"
    text = text.replace("../st16.toml", str(ROOT / "configs" / "st16.toml"))
    path.write_text(text.replace("frames = 8640", "frames = 10"))
    arguments = ["simulate", str(path), "--frames", "30", "--fragments", "--packets", str(LAYOUT)]
    documents = []
    for workers in ("1", "2"):
        out = ["--out", str(tmp_path / workers), "--workers", workers, "--json"]
        assert main([*arguments, *out]) == 0
        documents.append(json.loads(capsys.readouterr().out))
    assert documents[0]["parts"] == documents[1]["parts"]
    assert documents[0]["parts"]["calibration"]["frames"] == 30
    names = [path.relative_to(tmp_path / "1") for path in (tmp_path / "1").rglob("*.*")]
    assert len(names) == 2 + 4 * 2
    for name in names:
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "2" / name).read_bytes()


def test_other_fragments_are_not_left_among_new_ones(scenario, tmp_path):
    output = Output(tmp_path, truth_columns=False)
    short = with_frames(scenario, "calibration", 30)
    write_fragments(lay_out(short, 3), output)
    write_fragments(lay_out(short, 4), output)  # the same names: written anew
    (tmp_path / "calibration" / "ST16-1.calibration.2013-01-01.csv.gz").touch()
    with pytest.raises(InputError, match=r"2013-01-01\.csv\.gz: is of another simulation"):
        write_fragments(lay_out(short, 3), output)


def test_packets_count_on_from_day_to_day(scenario, tmp_path):
    output = Output(tmp_path, False, load_layout(LAYOUT))
    write_fragments(lay_out(with_frames(scenario, "calibration", 30), 3), output)
    second = tmp_path / "packets" / "calibration" / "ST16-1.calibration.2014-02-11.ccsds"
    assert int.from_bytes(second.read_bytes()[2:4], "big") & 0x3FFF == 24


def test_frames_in_place_of_the_scenario():
    scenario = load_scenario(ROOT / "configs" / "scenarios" / "st16-6.toml")
    lengths = [segment.frames for segment in scenario.calibration.segments]
    for wanted in (1, lengths[0], scenario.calibration.frames, scenario.calibration.frames + 7):
        changed = with_frames(scenario, "calibration", wanted)
        assert changed.calibration.frames == wanted
        assert changed.validation == scenario.validation


def test_command_refuses_workers_without_fragments(tmp_path, capsys):
    scenario = ROOT / "configs" / "scenarios" / "st16-1.toml"
    assert main(["simulate", str(scenario), "--out", str(tmp_path), "--workers", "2"]) == 2
    assert "--fragments" in capsys.readouterr().err
