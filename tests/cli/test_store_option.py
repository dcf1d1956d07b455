"""A store is a folder, or a URL for commands that only read it, with the same results."""

import json
import shutil

import fsspec
import pyarrow.parquet as pq
import pytest
from conftest import ROOT

from stcal.cli import main

CONFIG = str(ROOT / "configs" / "st16.toml")
SAMPLE = ROOT / "sample_telemetry"
SENSOR = "ST16-4"
INITIAL = SAMPLE / f"{SENSOR}.initial.json"
WRITING = {
    "ingest": ["ingest", CONFIG, "--config", CONFIG],
    "retry": ["quarantine", "retry"],
}
READING = {
    "list": ["quarantine", "list"],
    "show": ["quarantine", "show"],
    "match": ["match", "--sensor", SENSOR, "--calibration", INITIAL, "--out", "out"],
    "fit": ["fit", "--batch", "--sensor", SENSOR, "--initial", INITIAL, "--out", "out"],
    "validate": [
        "validate", "--sensor", SENSOR, "--baseline", INITIAL, "--candidate", INITIAL,
        "--out", "out",
    ],
    "align": [
        "align", "--sensor", SENSOR, "--calibration", INITIAL, "--body-sensor", "ST16-1",
        "--out", "out",
    ],
}  # fmt: skip


def run(*arguments):
    return main([str(argument) for argument in arguments])


@pytest.mark.parametrize("command", WRITING)
def test_writers_refuse_a_url_and_make_no_folder(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(*WRITING[command], "--store", "s3://bucket/store") == 3
    assert "s3://bucket/store: a store is written in a folder" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", READING)
def test_readers_look_at_the_url(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(*READING[command], "--store", "memory://none/store") == 3
    assert "memory://none/store: no stcal store here" in capsys.readouterr().err
    assert run(*READING[command], "--store", "s3://key:SECRET@bucket/store", "--json") == 3
    captured = capsys.readouterr()
    assert "credentials" in captured.err
    assert "SECRET" not in captured.out + captured.err
    assert not list(tmp_path.rglob("s3:*"))


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    folder = tmp_path_factory.mktemp("work")
    for part in ("calibration", "validation"):
        source = SAMPLE / f"{SENSOR}.{part}.csv.gz"
        assert run("ingest", source, "--store", folder / part, "--config", CONFIG) == 0
    system = fsspec.filesystem("memory")
    system.put(str(folder), "/work", recursive=True)
    yield folder
    system.rm("/work", recursive=True)


def documents(folder):
    """Every JSON document of a folder of results, without when it was made."""
    found = {path.name: json.loads(path.read_text()) for path in folder.glob("*.json")}
    for document in found.values():
        document.pop("created_utc", None)
    assert found
    return found


def test_a_url_gives_the_bits_of_the_folder(work, tmp_path):
    for name, root in (("folder", work), ("url", "memory://work")):
        out = tmp_path / name
        common = ["--sensor", SENSOR, "--workers", 2]
        fit = ["fit", "--batch", "--initial", INITIAL, "--out", out / "fit"]
        assert run(*fit, *common, "--store", f"{root}/calibration") == 0
        candidate = out / "fit" / "calibration.json"
        validate = ["validate", "--baseline", INITIAL, "--candidate", candidate]
        store = ["--store", f"{root}/validation"]
        assert run(*validate, "--out", out / "validation", *common, *store) == 0
        upload = ["uplink", "build", "--calibration", candidate, "--parent", INITIAL]
        upload += ["--validation", out / "validation" / "validation.json", "--out", out / "uplink"]
        assert run(*upload, "--store", f"{root}/calibration") == 0
    for part in ("fit", "validation"):
        assert documents(tmp_path / "folder" / part) == documents(tmp_path / "url" / part)
    assert "memory" not in (tmp_path / "url" / "fit" / "fit.json").read_text()


def test_worker_processes_read_the_url(work, tmp_path):
    tables = []
    shutil.copytree(work / "validation", tmp_path / "store")
    for name, options in (
        (str(work / "validation"), []),
        (f"file://{tmp_path}/store", ["--scheduler", "processes", "--workers", 2]),
    ):
        out = tmp_path / str(len(tables))
        arguments = ["--sensor", SENSOR, "--calibration", INITIAL, "--out", out, *options]
        assert run("match", *arguments, "--store", name) == 0
        tables.append(pq.read_table(out / "matches.parquet"))
    assert tables[0].equals(tables[1])
