"""A sensor's thinned sample telemetry, the work on it, and what an undisturbed run leaves."""

from __future__ import annotations

import gzip
import hashlib
import json
import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from chaos_driver import Ended, stcal

from stcal.calibration import load
from stcal.telemetry.store import Store

ROOT = Path(__file__).parents[2]
SENSOR, DAY = "ST16-4", "2014-09-04"
# `make chaos` sets it; in the short form each test takes a few of its cases.
LONG = os.environ.get("STCAL_CHAOS") == "1"
_CREATED = re.compile(rb'"created_utc": "[^"]*"')
PLAN = f"""
schema = "stcal.recalibration/1"
store = "store"
out = "out"
configs = ["{ROOT}/configs/st16.toml"]
sources = ["*.csv"]
[[sensors]]
sensor_id = "{SENSOR}"
onboard = "onboard.json"
fit = {{ to = "{DAY}" }}
validate = {{ from = "{DAY}" }}
"""


@dataclass(frozen=True)
class Scene:
    """A folder to work in; ``before`` holds what it was before each stage, by the stage's name."""

    work: Path
    before: Path
    reference: dict[str, dict[str, str]]

    def reset(self, stage: str) -> None:
        """Bring the folder back to what it was before a stage."""
        shutil.rmtree(self.work, ignore_errors=True)
        shutil.copytree(self.before / stage, self.work)

    def command(self, stage: str) -> list[object]:
        """Return the arguments of a stage's command."""
        work = self.work
        store = ("--store", work / "store")
        here = (*store, "--sensor", SENSOR)
        onboard, fitted = work / "onboard.json", work / "fit" / "calibration.json"
        fit = ("fit", *here, "--to", DAY, "--initial", onboard, "--out", work / "fit", "--json")
        return {
            "ingest": ["ingest", *self.downlinks(), *store,
                       "--config", ROOT / "configs" / "st16.toml", "--json"],
            "fit": [*fit, "--batch"],
            "sequential": [*fit, "--sequential", "ekf"],
            "validate": ["validate", *here, "--from", DAY, "--baseline", onboard,
                         "--candidate", fitted, "--out", work / "validation", "--json"],
            "build": ["uplink", "build", "--calibration", fitted, "--parent", onboard, "--json",
                      "--validation", work / "validation" / "validation.json", *store,
                      "--out", work / "uplink"],
            "recalibrate": ["recalibrate", work / "plan.toml", "--json"],
        }[stage]  # fmt: skip

    def downlinks(self) -> list[Path]:
        """Return the telemetry files."""
        return sorted(self.work.glob("*.csv"))

    def end(self, stage: str) -> None:
        """Check that the folder is what the undisturbed stage has left, with nothing beside it."""
        found, expected = snapshot(self.work), self.reference[stage]
        differ = {n for n in found.keys() | expected.keys() if found.get(n) != expected.get(n)}
        assert not differ, differ


STAGES = ("ingest", "fit", "validate", "build", "sequential", "recalibrate")
_FOLLOWS = {"fit": "ingest", "validate": "fit", "build": "validate", "sequential": "ingest"}


def make(folder: Path) -> Scene:
    """Make the telemetry, then run every stage undisturbed."""
    scene = Scene(folder / "work", folder / "before", {})
    ended = folder / "after"
    scene.work.mkdir()
    for name, every in (("calibration", 4), ("validation", 3)):
        _thin(ROOT / "sample_telemetry" / f"{SENSOR}.{name}.csv.gz", every, scene.work)
    onboard = ROOT / "sample_telemetry" / f"{SENSOR}.initial.json"
    shutil.copy(onboard, scene.work / "onboard.json")
    (scene.work / "plan.toml").write_text(PLAN)
    shutil.copytree(scene.work, ended / "nothing")
    for stage in STAGES:
        shutil.copytree(ended / _FOLLOWS.get(stage, "nothing"), scene.before / stage)
        scene.reset(stage)
        done = stcal(scene.command(stage), writes=True)
        assert done.code == 0, (stage, done)
        scene.reference[stage] = snapshot(scene.work)
        shutil.copytree(scene.work, ended / stage)
    return scene


def _thin(source: Path, every: int, folder: Path) -> None:
    """Write every so many frames of a telemetry file, with a row that is refused."""
    with gzip.open(source, "rt") as stream:
        header, *lines = stream.read().splitlines()
    numbers = [line.split(",")[1] for line in lines]
    kept = set(list(dict.fromkeys(numbers))[::every])
    text = [header, *(line for line, n in zip(lines, numbers, strict=True) if n in kept)]
    text.append(lines[-1].replace(SENSOR, "../../x"))
    (folder / source.stem).write_text("\n".join(text) + "\n")


def snapshot(folder: Path) -> dict[str, str]:
    """Return the hash of each file that a run must reproduce: all but locks, logs and times."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_dir() or path.name == ".lock" or path.suffix == ".log":
            continue
        content = path.read_bytes()
        if path.name.endswith(".step.json") or path.name in ("recalibration.json", "index.html"):
            content = b""  # they hold when and how long each step ran
        content = _CREATED.sub(b"", content)
        found[str(path.relative_to(folder))] = hashlib.sha256(content).hexdigest()
    return found


def whole(work: Path) -> None:
    """Check that whatever is there can be read: nothing is half-written."""
    if (work / "store" / "store.json").exists():
        store = Store.open(work / "store")
        store.quarantine()
        for sensor in store.sensors():
            store.read_frames(sensor)
    for path in visible(work):
        if path.name == "calibration.json":
            load(path)
        elif path.suffix == ".json":
            json.loads(path.read_text())


def visible(folder: Path) -> Iterator[Path]:
    """Yield the files that are not a killed writer's."""
    for path in folder.rglob("*"):
        hidden = any(part.startswith(".stcal-") for part in path.relative_to(folder).parts)
        if path.is_file() and not hidden:
            yield path


def told(ended: Ended) -> str:
    """Return a command's message, which is no traceback."""
    assert "Traceback" not in ended.err + ended.out, ended
    return ended.err
