"""Commands side by side on one store or one folder, and folders that go while they are read."""

import json
import random
import shutil
import time
from importlib import import_module

import pytest
from chaos_driver import stcal
from chaos_scene import LONG, ROOT, SENSOR, snapshot, told, whole
from test_chaos_world import process

from stcal.cli import inputs, main
from stcal.telemetry.store import Store

MORE = sorted((ROOT / "sample_telemetry").glob(f"{SENSOR}.*.csv.gz"))
READERS = {"fit": "fit", "sequential": "fit", "validate": "validate"}
RACES = 10 if LONG else 1


def ingest_more(scene):
    """Rewrite the days of the store, with all frames instead of some."""
    return ["ingest", *MORE, "--store", scene.work / "store",
            "--config", ROOT / "configs" / "st16.toml", "--json"]  # fmt: skip


def meanwhile(monkeypatch, stage, act):
    """Let something happen between a command's look at the store and its reading."""

    def read_inputs(*arguments):
        found = inputs.read_inputs(*arguments)
        act()
        return found

    monkeypatch.setattr(import_module(f"stcal.cli.{READERS[stage]}"), "read_inputs", read_inputs)


@pytest.mark.parametrize("stage", READERS)
def test_a_store_that_is_rewritten_while_it_is_read(scene, monkeypatch, stage):
    scene.reset(stage)
    before = snapshot(scene.work / "fit") if stage == "validate" else {}
    meanwhile(monkeypatch, stage, lambda: main([str(a) for a in ingest_more(scene)]))
    ended = stcal(scene.command(stage))
    assert ended.code == 3, ended
    assert "frames.parquet: the store changed while it was read; run again" in told(ended)
    after = snapshot(scene.work / "fit") if stage == "validate" else {}
    assert after == before


@pytest.mark.parametrize("stage", READERS)
def test_a_store_that_is_being_written_is_not_read(scene, stage):
    scene.reset(stage)
    with Store.open(scene.work / "store").lock():
        ended = stcal(scene.command(stage))
    assert ended.code == 3
    assert "is writing to this store; wait for its end" in told(ended)


@pytest.mark.parametrize("stage", READERS)
@pytest.mark.parametrize("gone", ["store", "out"])
def test_a_folder_that_vanishes(scene, monkeypatch, stage, gone):
    scene.reset(stage)
    command = scene.command(stage)
    folder = scene.work / "store" if gone == "store" else command[command.index("--out") + 1]
    meanwhile(monkeypatch, stage, lambda: shutil.rmtree(folder))
    ended = stcal(command)
    if (stage, gone) == ("validate", "out"):  # made anew, and all is written at the end
        scene.end(stage)
        return
    assert ended.code == 3, ended
    assert str(folder) in told(ended)
    whole(scene.work)


def test_two_ingests_of_one_store(scene):
    """One of them at least takes everything in; the other may be told to wait."""
    for _ in range(RACES):
        scene.reset("ingest")
        runs = [process(scene.command("ingest")) for _ in range(2)]
        told_by = [run.communicate(timeout=120)[1] for run in runs]
        assert sorted(run.returncode for run in runs)[0] == 0, told_by
        for run, said in zip(runs, told_by, strict=True):
            assert run.returncode == 0 or "is writing to this store" in said, said
        scene.end("ingest")


def test_two_fits_into_one_folder(scene):
    for _ in range(RACES):
        scene.reset("fit")
        runs = [process(scene.command("fit")) for _ in range(2)]
        told_by = [run.communicate(timeout=120)[1] for run in runs]
        assert sorted(run.returncode for run in runs)[0] == 0, told_by
        for run, said in zip(runs, told_by, strict=True):
            assert run.returncode == 0 or "another process is writing into this folder" in said
        found, expected = snapshot(scene.work), scene.reference["fit"]
        assert found.keys() == expected.keys()
        # The scene's own report holds no figures.
        assert {n for n in found if found[n] != expected[n]} <= {"fit/report.html"}


@pytest.mark.skipif(not LONG, reason="part of make chaos")
@pytest.mark.parametrize("stage", READERS)
def test_a_reader_beside_a_writer(scene, stage):
    """What it finds is the store before the ingest or the one after it, or it finds nothing."""
    rng, ends = random.Random(0), []
    out = "validation/validation.json" if stage == "validate" else "fit/fit.json"
    wanted = {}
    for ingested in (False, True):
        scene.reset(stage)
        if ingested:
            assert stcal(ingest_more(scene)).code == 0
        assert stcal(scene.command(stage)).code == 0
        document = json.loads((scene.work / out).read_text())
        wanted[document["provenance"]["telemetry_sha256"]] = snapshot(scene.work)[out]
    assert len(wanted) == 2
    for _ in range(RACES):
        scene.reset(stage)
        reader = process(scene.command(stage))
        time.sleep(rng.uniform(0, 1.5))
        writer = process(ingest_more(scene))
        said = reader.communicate(timeout=120)[1], writer.communicate(timeout=120)[1]
        assert writer.returncode == 0, said
        assert "Traceback" not in said[0]
        ends.append(reader.returncode)
        if reader.returncode == 0:
            digest = json.loads((scene.work / out).read_text())["provenance"]["telemetry_sha256"]
            assert snapshot(scene.work)[out] == wanted[digest]
        else:
            assert reader.returncode == 3
            assert "is writing to this store" in said[0] or "changed while it was" in said[0]
    assert 0 in ends
