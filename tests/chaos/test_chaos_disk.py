"""A full, read-only or forbidden disk at any touch: exit code 3, the path named, files whole."""

import os
import shutil
import subprocess

import pytest
from chaos_driver import ERRORS, stcal
from chaos_scene import LONG, STAGES, snapshot, told, visible, whole
from test_chaos_kill import points


@pytest.mark.parametrize("fault", ERRORS if LONG else ["ENOSPC"])
@pytest.mark.parametrize("stage", STAGES if LONG else ("ingest", "build"))
def test_disk_fails_at_any_touch(scene, stage, fault):
    scene.reset(stage)
    before = snapshot(scene.work)
    n = stcal(scene.command(stage), writes=True).touches
    for k in points(n, 4):
        scene.reset(stage)
        failed = stcal(scene.command(stage), fault, k, writes=True)
        if failed.code == 0:  # it was a file being removed that is in nobody's way
            continue
        assert failed.code == 3, (k, failed)
        # What a sensor of a fleet meets stands in the fleet's document.
        said = told(failed) + (failed.out if stage == "recalibrate" else "")
        assert os.strerror(ERRORS[fault]) in said
        assert str(scene.work) in said, (k, failed)
        whole(scene.work)
        files = [path for path in scene.work.rglob("*") if path.is_file()]
        assert len(list(visible(scene.work))) == len(files), "half-written files were left"
        now = snapshot(scene.work)
        assert all(now[name] in (before[name], scene.reference[stage][name]) for name in before)
        assert stcal(scene.command(stage)).code == 0
        scene.end(stage)


def test_a_fit_that_cannot_be_written_keeps_the_one_before(scene):
    scene.reset("validate")
    before = snapshot(scene.work)
    n = stcal(scene.command("fit"), writes=True).touches
    scene.reset("validate")
    # The last touches move the files into place; those before them write.
    failed = stcal(scene.command("fit"), "ENOSPC", n // 2, writes=True)
    assert failed.code == 3
    assert snapshot(scene.work) == before


def test_a_disk_that_is_really_full(scene, tmp_path):
    scene.reset("ingest")
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(disk)]
    if shutil.which("mount") is None or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("no right to mount a small disk here")
    try:
        command = [disk / "store" if a == scene.work / "store" else a
                   for a in scene.command("ingest")]  # fmt: skip
        failed = stcal(command)
        assert failed.code == 3
        assert "No space left" in told(failed)
        assert str(disk) in failed.err
        assert not list(disk.rglob(".stcal-*"))
        subprocess.run(["mount", "-o", "remount,size=8m", str(disk)], check=True)
        assert stcal(command).code == 0
        found = {n.removeprefix("store/"): h for n, h in scene.reference["ingest"].items()
                 if n.startswith("store/")}  # fmt: skip
        assert snapshot(disk / "store") == found
    finally:
        subprocess.run(["umount", str(disk)], check=False)
