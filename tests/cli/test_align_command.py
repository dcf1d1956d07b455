"""``stcal align`` does what the core does, and says what is wrong with its input."""

import json

import numpy as np
import pytest
from conftest import ROOT, st16_matcher
from scipy.spatial.transform import Rotation

from stcal.calibration import load, save
from stcal.cli import main
from stcal.pipeline.align import AlignOptions, align
from stcal.simulate import load_scenario, scenario_with, simulate
from stcal.simulate.attitude import mounting_rotation
from stcal.telemetry.attitudes import read_attitudes
from stcal.telemetry.store import Store
from stcal.telemetry.writer import write_csv
from stcal.times import format_utc_array

SENSOR, OTHER = "ST16-4", "ST16-3"
CONFIG = ROOT / "configs" / "st16.toml"


def run(capsys, *arguments):
    code = main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A store with sensors 3 and 4 of one satellite, their calibrations, an attitude record."""
    folder = tmp_path_factory.mktemp("align")
    change = {"calibration__segments__0__wander_deg": 0.0, "calibration__segments__0__frames": 90,
              "validation__segments__0__frames": 20}  # fmt: skip
    for sensor in (SENSOR, OTHER):
        scenario = load_scenario(ROOT / "configs" / "scenarios" / f"{sensor.lower()}.toml")
        data = simulate(scenario_with(scenario, **change), 7)
        write_csv([data.calibration.frames], folder / f"{sensor}.csv.gz")
        save(data.true, folder / f"{sensor}.json")
        save(data.initial, folder / f"{sensor}.initial.json")
        if sensor == SENSOR:
            write_record(data, folder / "body.csv")
    sources = [str(folder / f"{sensor}.csv.gz") for sensor in (SENSOR, OTHER)]
    arguments = ["ingest", *sources, "--store", str(folder / "store"), "--config", str(CONFIG)]
    assert main([*arguments, "--json"]) == 0
    return folder


def write_record(data, path):
    part, rng = data.calibration, np.random.default_rng(1)
    c_bs = mounting_rotation(data.scenario.mounting)
    c_ib = Rotation.from_quat(part.truth.q_si[::2]) * c_bs.inv()
    noisy = c_ib * Rotation.from_rotvec(rng.normal(0.0, 3e-5, (len(c_ib), 3)))
    times = format_utc_array(part.frames.t_tai_ns)
    lines = ["time_utc,q_x,q_y,q_z,q_w,sd_urad"]
    lines += [
        ",".join([str(t), *(f"{v:.12f}" for v in q), "30"])
        for t, q in zip(times, noisy.as_quat(), strict=True)
    ]
    path.write_text("\n".join(lines) + "\n")


def arguments(work, out, *more, calibration=None):
    chosen = calibration or work / f"{SENSOR}.json"
    return ("align", "--store", work / "store", "--sensor", SENSOR, "--calibration", chosen,
            "--out", out, *more)  # fmt: skip


def test_the_command_does_what_the_core_does(work, capsys, tmp_path):
    code, out, _ = run(
        capsys, *arguments(work, tmp_path, "--body", work / "body.csv", "--json", "--workers", 2)
    )
    assert code == 0
    document = json.loads(out)
    assert json.loads((tmp_path / "alignment.json").read_text()) == document
    assert "<html" in (tmp_path / "report.html").read_text()
    frames = Store.open(work / "store").read_frames(SENSOR)
    body = read_attitudes(work / "body.csv")
    calibration = load(work / f"{SENSOR}.json")
    core = align([frames], calibration, body, st16_matcher(), {}, AlignOptions())
    for name, method in core["methods"].items():
        assert document["methods"][name] == method
    for key in ("verdict", "frames", "frames_used", "stars_used", "nis", "noise", "history"):
        assert document[key] == core[key], key
    assert set(document["provenance"]) >= {
        "telemetry_sha256", "catalogue_sha256", "config_sha256", "calibration_sha256",
    }  # fmt: skip
    assert document["body"]["file"] == "body.csv"


def test_the_options_reach_the_core(work, capsys, tmp_path):
    more = ("--body", work / "body.csv", "--method", "linear", "--attitude-sd-urad", 40,
            "--maximum-gap-s", 3, "--matching", "guided", "--json")  # fmt: skip
    code, out, _ = run(capsys, *arguments(work, tmp_path, *more))
    assert code == 0
    document = json.loads(out)
    assert document["result"] == document["methods"]["linear"]
    assert document["body"]["attitude_sd_urad"] == 40
    assert document["body"]["maximum_gap_s"] == 3
    assert document["nis"]["mean"] < 3.5


def test_another_sensor_of_the_store_as_the_body(work, capsys, tmp_path):
    solved = ("--body-sensor", OTHER, "--body-calibration", work / f"{OTHER}.json", "--json")
    code, out, _ = run(capsys, *arguments(work, tmp_path, *solved))
    assert code == 0
    document = json.loads(out)
    assert document["body"]["attitudes"] == "solved"
    assert document["body"]["sensor"] == OTHER
    truth = _mounting(SENSOR) @ _mounting(OTHER).T
    turn = Rotation.from_matrix(np.array(document["result"]["c_sb"]) @ truth.T).as_rotvec()
    sd = np.radians(np.array(document["result"]["sd_arcsec"]) / 3600.0)
    assert (np.abs(turn) < 4.0 * sd).all()


def test_the_telemetered_attitudes_of_another_sensor(work, capsys, tmp_path):
    """They were made with the initial calibration: hundreds of urad of noise nobody stated."""
    code, out, _ = run(capsys, *arguments(work, tmp_path, "--body-sensor", OTHER, "--json"))
    document = json.loads(out)
    assert code == 4
    assert document["body"]["attitudes"] == "telemetered"
    assert document["noise"]["attitude_excess_urad"] > 100


def _mounting(sensor):
    scenario = load_scenario(ROOT / "configs" / "scenarios" / f"{sensor.lower()}.toml")
    return mounting_rotation(scenario.mounting).inv().as_matrix()


def test_a_refused_alignment_ends_in_exit_4_without_a_result(work, capsys, tmp_path):
    more = ("--body", work / "body.csv", "--json")
    initial = work / f"{SENSOR}.initial.json"
    code, out, err = run(capsys, *arguments(work, tmp_path, *more, calibration=initial))
    assert code == 4
    document = json.loads(out)
    assert document["result"] is None
    assert document["exit_code"] == 4
    assert "refused: " in err
    assert json.loads((tmp_path / "alignment.json").read_text())["result"] is None
    assert "Alignment refused" in (tmp_path / "report.html").read_text()


def test_the_table_for_people(work, capsys, tmp_path):
    code, out, _ = run(capsys, *arguments(work, tmp_path, "--body", work / "body.csv"))
    assert code == 0
    assert "ST16-4: Alignment accepted" in out
    for shown in ("Multiplicative", "Roll [deg]", "C_SB row z", "NIS per frame, mean"):
        assert shown in out


BAD = [
    ((), 2, "--body ATTITUDES or --body-sensor SENSOR"),
    (("--body", "B", "--body-sensor", OTHER), 2, "--body ATTITUDES or --body-sensor SENSOR"),
    (("--body", "B", "--body-calibration", "C"), 2, "--body-calibration belongs to --body-sensor"),
    (("--body-sensor", SENSOR), 2, "is the sensor that is to be aligned"),
    (("--body", "B", "--attitude-sd-urad", "nan"), 2, "not a number"),
    (("--body", "B", "--maximum-gap-s", "-1"), 2, "--maximum-gap-s"),
    (("--body", "none.csv"), 3, "none.csv"),
    (("--body", "C"), 3, "missing column(s): time_utc"),
    (("--body-sensor", "ST16-9"), 3, "ST16-9"),
    (("--body-sensor", OTHER, "--body-calibration", "C"), 3, "sensor ST16-4, not ST16-3"),
    (("--body", "B", "--from", "2031-01-01"), 3, SENSOR),
    (("--body", "B", "--config", ROOT / "configs" / "esa_tetra3.toml"), 3, "esa_tetra3"),
]


@pytest.mark.parametrize(("more", "code", "message"), BAD)
def test_mistakes_get_a_message_and_their_exit_code(work, capsys, tmp_path, more, code, message):
    places = {"B": work / "body.csv", "C": work / f"{SENSOR}.json"}
    found, out, err = run(capsys, *arguments(work, tmp_path, *(places.get(m, m) for m in more)))
    assert found == code
    assert message in " ".join(err.split())
    assert "Traceback" not in err
    assert out == ""
