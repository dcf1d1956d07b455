"""A fleet's recalibration: the plan, what is done again and what isn't, and who goes on."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
from conftest import ROOT

from stcal.cli import main
from stcal.errors import ConfigError
from stcal.execution import scheduler, serial
from stcal.operations.plan import load_plan
from stcal.operations.record import Outcome, key_of, recall, remember
from stcal.operations.run import Runner, recalibrate, worst
from stcal.operations.steps import Step, ingest_step, sensor_steps

PLAN = """
schema = "stcal.recalibration/1"
store = "store"
out = "out"
configs = ["sensor.toml"]
sources = ["downlink/*.csv"]
"""
SENSOR = """
[[sensors]]
sensor_id = "{name}"
onboard = "{name}.json"
fit = {{ to = "2026-02-01" }}
validate = {{ from = "2026-02-01" }}
"""


def write_plan(folder, names=("A-1", "A-2"), text=PLAN):
    (folder / "downlink").mkdir(exist_ok=True)
    (folder / "downlink" / "x.csv").write_text("telemetry")
    (folder / "sensor.toml").write_text("config")
    for name in names:
        (folder / f"{name}.json").write_text(f"onboard {name}")
    path = folder / "plan.toml"
    path.write_text(text + "".join(SENSOR.format(name=name) for name in names))
    return path


class Pretended(Runner):
    """Commands that only write their outputs and end with a given code."""

    def __init__(self, codes=()):
        super().__init__()
        self.codes, self.called = dict(codes), []

    def command(self, arguments):
        name = arguments[1] if arguments[0] == "uplink" else arguments[0]
        where = Path(arguments[arguments.index("--out") + 1]) if "--out" in arguments else None
        sensor = next((part for part in where.parts if part.startswith("A-")), "") if where else ""
        self.called.append((sensor, name))
        code = self.codes.get((sensor, name), 0)
        if code == 0 and where is not None:
            files = {"fit": ("calibration.json", "fit.json"), "validate": ("validation.json",),
                     "build": ("serial-0002/table.json",)}  # fmt: skip
            for file in files.get(name, ()):
                (where / file).parent.mkdir(parents=True, exist_ok=True)
                (where / file).write_text(f"{sensor} {file}")
        if code == 0:
            return 0, "{}", ""
        return code, json.dumps({"error": f"{name} says {code}"}), f"stcal: {name} says {code}"


def run(path, runner, mapper=serial):
    return recalibrate(load_plan(path), mapper, runner)


def test_what_a_killed_run_was_writing_is_cleared_away(tmp_path):
    path, left = write_plan(tmp_path), tmp_path / "out" / "A-2" / ".stcal-left"
    left.parent.mkdir(parents=True)
    left.write_text("half of a rec")
    run(path, Pretended())
    assert not left.exists()


def test_every_sensor_goes_through_all_steps_in_order(tmp_path):
    runner = Pretended()
    found = run(write_plan(tmp_path), runner)
    assert found.exit_code == 0
    assert [one.state for one in found.sensors] == ["built", "built"]
    steps = ["fit", "validate", "build", "report"]
    expected = [("", "ingest"), *((name, step) for name in ("A-1", "A-2") for step in steps)]
    assert runner.called == expected
    log = (tmp_path / "out" / "A-1" / "fit.log").read_text()
    assert log.startswith(f"stcal fit --batch --store {tmp_path}/store --sensor A-1")


@pytest.mark.parametrize("workers", [1, 3])
@pytest.mark.parametrize(
    ("codes", "states", "code"),
    [
        ({("A-1", "fit"): 4}, ["refused", "built", "built"], 4),
        ({("A-2", "validate"): 4}, ["built", "refused", "built"], 4),
        ({("A-3", "build"): 4, ("A-1", "fit"): 3}, ["failed", "built", "refused"], 3),
        ({("A-1", "fit"): 1, ("A-2", "fit"): 3}, ["failed", "failed", "built"], 1),
        ({("A-1", "fit"): -9}, ["failed", "built", "built"], 1),
        ({("", "ingest"): 5}, ["built", "built", "built"], 5),
        ({("", "ingest"): 3}, ["built", "built", "built"], 3),
    ],
)
def test_good_sensors_go_on_and_the_worst_code_is_told(tmp_path, workers, codes, states, code):
    runner = Pretended(codes)
    with scheduler(workers) as mapper:
        found = run(write_plan(tmp_path, ("A-1", "A-2", "A-3")), runner, mapper)
    assert [one.state for one in found.sensors] == states
    assert found.exit_code == code
    for sensor, name in codes:
        after = ["fit", "validate", "build"][["fit", "validate", "build"].index(name) + 1 :] if (
            sensor
        ) else []  # fmt: skip
        assert not [call for call in runner.called if call[0] == sensor and call[1] in after]


def test_the_worst_of_exit_codes():
    assert worst([]) == 0
    assert worst([0, 5]) == 5
    assert worst([5, 4]) == 4
    assert worst([4, 3]) == 3
    assert worst([3, 1]) == 1
    assert worst([1, 130]) == 130
    assert worst([-11, 0]) == 1


def test_what_is_done_is_not_done_again(tmp_path):
    path = write_plan(tmp_path)
    run(path, Pretended())
    again = Pretended()
    found = run(path, again)
    assert again.called == [("A-1", "report"), ("A-2", "report")]  # no report file was pretended
    assert all(outcome.again for one in found.sensors for outcome in one.outcomes)
    assert found.exit_code == 0


@pytest.mark.parametrize(
    ("change", "redone"),
    [
        (lambda f: (f / "A-1.json").write_text("other"), {"fit", "validate", "build"}),
        (lambda f: (f / "sensor.toml").write_text("other"), {"fit", "validate", "build"}),
        (lambda f: (f / "out/A-1/fit/calibration.json").write_text("damaged"), {"fit"}),
        (lambda f: (f / "out/A-1/fit/fit.json").unlink(), {"fit"}),
        (lambda f: (f / "out/A-1/validation/validation.json").unlink(), {"validate"}),
        (lambda f: (f / "out/A-1/uplink/serial-0002/table.json").write_text("x"), {"build"}),
        (lambda f: (f / "out/A-1/uplink/serial-0002/more.json").write_text("x"), {"build"}),
        (lambda f: (f / "out/A-1/validate.step.json").write_text("{"), {"validate"}),
        (lambda f: (f / "out/A-1/validate.step.json").write_text("[]"), {"validate"}),
        (lambda f: (f / "out/A-1/validate.step.json").unlink(), {"validate"}),
    ],
)
def test_what_changed_is_done_again(tmp_path, change, redone):
    path = write_plan(tmp_path, ("A-1",))
    run(path, Pretended())
    change(tmp_path)
    again = Pretended()
    found = run(path, again)
    assert {name for sensor, name in again.called if sensor and name != "report"} == redone
    assert found.exit_code == 0


def test_a_failure_is_tried_again_and_a_refusal_is_not(tmp_path):
    path = write_plan(tmp_path)
    codes = {("A-1", "fit"): 3, ("A-2", "validate"): 4}
    run(path, Pretended(codes))
    again = Pretended(codes)
    found = run(path, again)
    assert ("A-1", "fit") in again.called
    assert ("A-2", "validate") not in again.called
    assert found.sensors[1].outcomes[-1].again
    assert found.sensors[1].outcomes[-1].message == "validate says 4"
    assert found.exit_code == 3


def test_a_new_telemetry_file_is_ingested(tmp_path):
    path = write_plan(tmp_path)
    run(path, Pretended())
    (tmp_path / "downlink" / "y.csv").write_text("more")
    again = Pretended()
    run(path, again)
    assert again.called[0] == ("", "ingest")


def test_a_record_holds_only_for_its_step(tmp_path):
    source = tmp_path / "in"
    source.write_text("a")
    step = Step("fit", ("fit", "--x"), tmp_path, (source,), ())
    remember(step, key_of(step), Outcome("fit", 0, "", 1.0))
    assert recall(step, key_of(step)) == Outcome("fit", 0, "", 1.0, again=True)
    other = Step("fit", ("fit", "--y"), tmp_path, (source,), ())
    assert recall(other, key_of(other)) is None
    source.write_text("b")
    assert recall(step, key_of(step)) is None


def test_paths_and_options_of_the_commands(tmp_path):
    text = PLAN + 'target = "target.toml"\ningest_options = ["--config", "b.toml"]\n'
    text += '[fit]\nmethod = "sqrf"\noptions = ["--residual", "direction"]\n'
    file = load_plan(write_plan(tmp_path, ("A-1",), text))
    first = ingest_step(file)
    assert first.arguments[:2] == ("ingest", str(tmp_path / "downlink" / "x.csv"))
    assert first.arguments[-2:] == ("--config", "b.toml")
    fit, validate, build = sensor_steps(file, file.plan.sensors[0])
    assert fit.arguments[:5] == ("fit", "--sequential", "sqrf", "--residual", "direction")
    assert fit.arguments[fit.arguments.index("--to") + 1] == "2026-02-01"
    assert "--from" not in fit.arguments
    assert validate.arguments[validate.arguments.index("--from") + 1] == "2026-02-01"
    assert build.arguments[build.arguments.index("--target") + 1] == str(tmp_path / "target.toml")
    assert tmp_path / "target.toml" in build.inputs


@pytest.mark.parametrize(
    ("text", "names", "message"),
    [
        (PLAN, ("A-1", "A-1"), "listed more than once: A-1"),
        (PLAN, (), "sensors"),
        (PLAN, ("../A",), "cannot be the name of a folder"),
        (PLAN.replace("stcal.recalibration/1", "other/1"), ("A-1",), "schema"),
        (PLAN + "zeal = 3\n", ("A-1",), "zeal"),
        (PLAN + '[fit]\nmethod = "guess"\n', ("A-1",), "fit.method"),
        ("out = [", ("A-1",), "not TOML"),
    ],
)
def test_mistakes_in_a_plan_are_named(tmp_path, text, names, message):
    path = tmp_path / "plan.toml"
    path.write_text(text + "".join(SENSOR.format(name=name) for name in names))
    with pytest.raises(ConfigError, match=re.escape(message)) as error:
        load_plan(path)
    assert str(path) in str(error.value)


def test_judging_on_the_frames_of_the_fit_is_refused(tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(PLAN + '[[sensors]]\nsensor_id = "A"\nonboard = "a.json"\n')
    with pytest.raises(ConfigError, match="proves nothing on its own frames"):
        load_plan(path)


def test_a_source_that_is_not_there_is_told_before_the_work(tmp_path, capsys):
    path = write_plan(tmp_path)
    shutil.rmtree(tmp_path / "downlink")
    assert main(["recalibrate", str(path), "--json"]) == 3
    assert "'downlink/*.csv' finds no file" in json.loads(capsys.readouterr().out)["error"]
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def fleet(tmp_path_factory):
    """A plan of two simulated sensors with few frames, and one that has no telemetry."""
    folder = tmp_path_factory.mktemp("fleet")
    for number in (4, 5):
        text = (ROOT / "configs" / "scenarios" / f"st16-{number}.toml").read_text()
        text = text.replace("../", f"{ROOT}/configs/")
        text = re.sub(r"frames = (400|150)", lambda m: f"frames = {int(m[1]) * 2 // 5}", text)
        (folder / "scenario.toml").write_text(text)
        arguments = ["simulate", str(folder / "scenario.toml"), "--out", str(folder), "--json"]
        assert main(arguments) == 0
    (folder / "plan.toml").write_text(
        'schema = "stcal.recalibration/1"\nstore = "store"\nout = "out"\n'
        f'configs = ["{ROOT}/configs/st16.toml"]\nsources = ["*.csv.gz"]\n'
        + "".join(
            f'[[sensors]]\nsensor_id = "ST16-{n}"\nonboard = "ST16-{m}.initial.json"\n'
            f'fit = {{ to = "{day}" }}\nvalidate = {{ from = "{day}" }}\n'
            for n, m, day in (
                (4, 4, "2014-09-04"),
                (5, 5, "2014-07-21T05:00:00Z"),
                (9, 4, "2014-09-04"),
            )
        )
    )
    return folder


def test_the_command_builds_the_good_sensors_uploads(fleet, capsys):
    capsys.readouterr()
    code = main(["recalibrate", str(fleet / "plan.toml"), "--json"])
    document = json.loads(capsys.readouterr().out)
    states = {item["sensor_id"]: item["state"] for item in document["sensors"]}
    assert states["ST16-9"] == "failed"
    assert states["ST16-4"] == states["ST16-5"] == "built", document["sensors"]
    assert code == document["exit_code"] == 3
    first = document["sensors"][0]
    assert first["common_pair_rms_urad"]["candidate"] < first["common_pair_rms_urad"]["baseline"]
    upload = fleet / "out" / first["upload"]
    assert any(upload.iterdir())
    index = (fleet / "out" / "index.html").read_text()
    assert 'href="ST16-4/report.html"' in index
    assert "no frames of sensor" in index
    before = {p: p.stat().st_mtime_ns for p in upload.rglob("*")}
    assert main(["recalibrate", str(fleet / "plan.toml"), "--json"]) == 3
    again = json.loads(capsys.readouterr().out)
    assert all(step["again"] for step in again["sensors"][0]["steps"])
    assert {p: p.stat().st_mtime_ns for p in upload.rglob("*")} == before


def started(plan):
    """A recalibration in a process of its own, when its first fit is running."""
    command = [sys.executable, "-m", "stcal", "recalibrate", str(plan), "--json"]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while not (plan.parent / "out" / "ingest.step.json").exists():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return process


def steps_of(plan):
    """The processes of a recalibration's steps."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            words = path.read_bytes().split(b"\0")
            if str(plan.parent / "store").encode() in words:
                found.append(int(path.parent.name))
    return found


def test_the_steps_of_a_killed_run_end_too(fleet, tmp_path):
    """kill -9 of the run alone: its step doesn't go on writing where nobody waits for it."""
    for path in fleet.iterdir():
        if path.is_file():
            shutil.copy(path, tmp_path)
    plan = tmp_path / "plan.toml"
    with started(plan) as process:
        deadline = time.monotonic() + 60
        while not steps_of(plan):
            assert time.monotonic() < deadline
            time.sleep(0.02)
        process.kill()
    while steps_of(plan):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    assert not (tmp_path / "out" / "ST16-4" / "fit" / "calibration.json").exists()


def test_an_interrupted_run_goes_on_to_the_same_end(fleet, tmp_path):
    """SIGINT while the first fit runs: exit code 130; then the rest is done."""
    for path in fleet.iterdir():
        if path.is_file():
            shutil.copy(path, tmp_path)
    with started(tmp_path / "plan.toml") as process:
        time.sleep(0.5)
        os.killpg(process.pid, signal.SIGINT)
        process.communicate(timeout=60)
    assert process.returncode == 130
    assert not (tmp_path / "out" / "ST16-4" / "fit.step.json").exists()
    assert main(["recalibrate", str(tmp_path / "plan.toml"), "--json"]) == 3
    for name in ("fit/calibration.json",):
        ours = json.loads((tmp_path / "out" / "ST16-4" / name).read_text())
        theirs = json.loads((fleet / "out" / "ST16-4" / name).read_text())
        assert ours["camera"] == theirs["camera"]
