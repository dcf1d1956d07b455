"""The command on a small fleet: what it builds, and that no scheduler or interrupt changes it."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from conftest import ROOT
from dask_cluster import cluster

from stcal.cli import main

SENSOR, MISSING, DAY = "ST16-4", "ST16-9", "2014-09-04"
PLAN = f"""
schema = "stcal.recalibration/1"
store = "store"
out = "out"
configs = ["{ROOT}/configs/st16.toml"]
sources = ["*.csv.gz"]
""" + "".join(
    f'[[sensors]]\nsensor_id = "{sensor}"\nonboard = "{SENSOR}.initial.json"\n'
    f'fit = {{ to = "{DAY}" }}\nvalidate = {{ from = "{DAY}" }}\n'
    for sensor in (MISSING, SENSOR)
)


@pytest.fixture(scope="module")
def downlink(tmp_path_factory) -> Path:
    """A plan of a simulated sensor with few frames, and of one that has no telemetry."""
    folder = tmp_path_factory.mktemp("fleet")
    text = (ROOT / "configs" / "scenarios" / "st16-4.toml").read_text()
    text = text.replace("../", f"{ROOT}/configs/")
    text = re.sub(r"frames = (400|150)", lambda m: f"frames = {int(m[1]) * 2 // 5}", text)
    (folder / "scenario.toml").write_text(text)
    (folder / "plan.toml").write_text(PLAN)
    arguments = ["simulate", str(folder / "scenario.toml"), "--out", str(folder), "--json"]
    assert main(arguments) == 0
    return folder


@pytest.fixture(scope="module")
def fleet(downlink) -> tuple[Path, dict]:
    """The fleet's folder after an undisturbed run, and the run's document."""
    folder = shutil.copytree(downlink, downlink.parent / f"{downlink.name}-run")
    assert main(["recalibrate", str(folder / "plan.toml"), "--json"]) == 3
    return folder, json.loads((folder / "out" / "recalibration.json").read_text())


def test_the_command_builds_the_good_sensors_upload(fleet, capsys):
    folder, document = fleet
    missing, built = document["sensors"]
    assert (missing["state"], built["state"]) == ("failed", "built"), document
    assert document["exit_code"] == 3
    assert built["common_pair_rms_urad"]["candidate"] < built["common_pair_rms_urad"]["baseline"]
    upload = folder / "out" / built["upload"]
    assert any(upload.iterdir())
    index = (folder / "out" / "index.html").read_text()
    assert f'href="{SENSOR}/report.html"' in index
    assert "no frames of sensor" in index
    before = {p: p.stat().st_mtime_ns for p in upload.rglob("*")}
    assert main(["recalibrate", str(folder / "plan.toml"), "--json"]) == 3
    again = json.loads(capsys.readouterr().out)
    assert all(step["again"] for step in again["sensors"][1]["steps"])
    assert {p: p.stat().st_mtime_ns for p in upload.rglob("*")} == before


def test_interrupted_under_any_scheduler_it_goes_on_to_the_same_end(fleet, downlink, tmp_path):
    """A sensor's steps are done by three schedulers in turn, each interrupted in a step."""
    pytest.importorskip("distributed")
    shutil.copytree(downlink, tmp_path, dirs_exist_ok=True)
    with cluster(tmp_path, 1) as (address, _):
        interrupted(tmp_path, "fit", signal.SIGINT, "--workers", "2")
        interrupted(tmp_path, "validate", signal.SIGTERM, "--scheduler", "processes")
        interrupted(tmp_path, "validate", signal.SIGINT, "--scheduler", address)
        command = ["recalibrate", str(tmp_path / "plan.toml"), "--json", "--scheduler", address]
        assert main(command) == 3
    document = json.loads((tmp_path / "out" / "recalibration.json").read_text())
    assert [step["again"] for step in document["sensors"][1]["steps"]] == [True, False, False]
    assert comparable(document["sensors"][1]) == comparable(fleet[1]["sensors"][1])
    assert document["sensors"][0]["state"] == "failed"
    for name in ("fit/calibration.json", "validation/validation.json"):
        ours, theirs = (
            json.loads((folder / "out" / SENSOR / name).read_text())
            for folder in (tmp_path, fleet[0])
        )
        assert comparable(ours) == comparable(theirs)
    assert not list((tmp_path / "out").glob(".*"))


def test_the_steps_of_a_killed_run_end_too(downlink, tmp_path):
    """kill -9 of the run alone: its step doesn't go on writing where nobody waits for it."""
    shutil.copytree(downlink, tmp_path, dirs_exist_ok=True)
    with started(tmp_path, "fit") as process:
        process.kill()
    await_(lambda: not steps(tmp_path, "fit"))
    assert not (tmp_path / "out" / SENSOR / "fit" / "calibration.json").exists()


@contextmanager
def started(folder: Path, step: str, *options: str) -> Iterator[subprocess.Popen]:
    """A recalibration in a process of its own, when a step is running."""
    command = [sys.executable, "-m", "stcal", "recalibrate", "plan.toml", "--json", *options]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)}, start_new_session=True,
    ) as process:  # fmt: skip
        await_(lambda: steps(folder, step) or process.poll() is not None)
        assert process.poll() is None, process.communicate()
        yield process


def interrupted(folder: Path, step: str, number: signal.Signals, *options: str) -> None:
    """Signal the command while a step runs; it ends with code 130, and the step with it."""
    with started(folder, step, *options) as process:
        # A terminal signals the workers too, a service manager perhaps only the command.
        send = os.killpg if number == signal.SIGINT else os.kill
        send(process.pid, number)
        printed, told = process.communicate(timeout=60)
    assert process.returncode == 130, (printed, told)
    assert b"Traceback" not in told, told
    await_(lambda: not steps(folder, step))
    record = folder / "out" / SENSOR / f"{step}.step.json"
    # A signal amid its imports may end it in an error, which is tried again.
    assert not record.exists() or json.loads(record.read_text())["outcome"]["exit_code"] == 1


def steps(folder: Path, step: str) -> list[int]:
    """Return the processes that run a step of the sensor."""
    import psutil

    found = []
    for process in psutil.process_iter(["cmdline"]):
        arguments = process.info["cmdline"] or []
        if step in arguments and str(folder / "store") in arguments and SENSOR in arguments:
            found.append(process.pid)
    return found


def await_(condition) -> None:
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def comparable(document):
    """Return a document without what depends on the run: when and how long it ran."""
    if isinstance(document, list):
        return [comparable(item) for item in document]
    if not isinstance(document, dict):
        return document
    own = ("created_utc", "seconds", "again")
    return {key: comparable(value) for key, value in document.items() if key not in own}
