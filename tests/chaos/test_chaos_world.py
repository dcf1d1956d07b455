"""Two processes at a time, odd clocks, zones, encodings and folder names, and random kills."""

import os
import random
import shutil
import signal
import subprocess
import sys
import time

import pytest
from chaos_driver import stcal
from chaos_scene import LONG, ROOT, snapshot, told, whole

from stcal.atomic import locked
from stcal.telemetry.store import Store

KILLS = 10


def process(arguments, **environment):
    return subprocess.Popen(
        [sys.executable, "-m", "stcal", *map(str, arguments)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, errors="replace",
        env=os.environ | {"PYTHONPATH": str(ROOT)} | environment, start_new_session=True,
    )  # fmt: skip


def test_two_writers_of_one_store_and_of_one_folder(scene):
    scene.reset("fit")
    with Store.open(scene.work / "store").lock():
        second = stcal(scene.command("ingest"))
    assert second.code == 3
    assert f"process {os.getpid()} is writing to this store" in told(second)
    (scene.work / "fit").mkdir()
    with locked(scene.work / "fit"):
        second = stcal(scene.command("fit"))
    assert second.code == 3
    assert "another process is writing into this folder" in told(second)
    scene.reset("build")
    (scene.work / "uplink").mkdir()
    with locked(scene.work / "uplink"):
        second = stcal(scene.command("build"))
    assert second.code == 3
    assert "another process is building here" in told(second)


@pytest.mark.parametrize(
    "environment",
    [
        {"TZ": "Pacific/Kiritimati", "LC_ALL": "de_DE.UTF-8"},
        {"TZ": "America/St_Johns", "LC_ALL": "C", "PYTHONIOENCODING": "ascii"},
    ],
)
def test_zones_encodings_and_names_leave_no_trace(scene, tmp_path, environment):
    scene.reset("ingest")
    folder = tmp_path / "Übungsmond ☾ \udcff"
    os.mkdir(folder)
    for path in scene.downlinks():
        os.utime(shutil.copy(path, folder), (4e9, 4e9))
    command = ["ingest", *sorted(folder.iterdir()), "--store", folder / "store",
               "--config", ROOT / "configs" / "st16.toml"]  # fmt: skip
    run = process(command, **environment)
    _, err = run.communicate(timeout=120)
    assert run.returncode == 0, err
    expected = {name.removeprefix("store/"): digest
                for name, digest in scene.reference["ingest"].items()
                if name.startswith("store/")}  # fmt: skip
    assert snapshot(folder / "store") == expected


@pytest.mark.skipif(not LONG, reason="part of make chaos")
@pytest.mark.parametrize("stage", ["ingest", "fit", "build", "recalibrate"])
def test_killed_at_random_times(scene, stage):
    """The process group of the real command is killed, as a power cut does it."""
    rng = random.Random(0)
    scene.reset(stage)
    began = time.monotonic()
    assert process(scene.command(stage)).wait() == 0
    took = time.monotonic() - began
    for _ in range(KILLS):
        scene.reset(stage)
        run = process(scene.command(stage))
        time.sleep(rng.uniform(0, took))
        if run.poll() is None:
            os.killpg(run.pid, signal.SIGKILL)
        run.communicate()
        whole(scene.work)
        assert stcal(scene.command(stage)).code == 0
        found, expected = snapshot(scene.work), scene.reference[stage]
        assert found.keys() == expected.keys()
        # The scene's own reports hold no figures.
        drawn = {name for name in found if name.endswith("report.html") and "uplink" not in name}
        assert all(found[name] == expected[name] for name in found.keys() - drawn)
