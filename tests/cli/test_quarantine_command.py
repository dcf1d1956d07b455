"""``stcal quarantine`` and ``stcal ingest --mapping``: what the core gives, printed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from stcal.cli import main
from stcal.telemetry.quarantine_list import Selection, listing

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / "configs" / "st16.toml"
HEADER = (
    "sensor_id,frame_id,time_utc,best_exposure,q_x,q_y,q_z,q_w,rate_x_deg_s,rate_y_deg_s,"
    "rate_z_deg_s,temperature_c,exposure,row_px,col_px,intensity,star_id"
)


def call(capsys, *arguments):
    code = main([*map(str, arguments)])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.fixture
def store(tmp_path, capsys):
    """A store with two refused rows: one star off a small detector, one that is no text."""
    line = "ST16-1,7,2026-01-05T12:00:00.000Z,0,0,0,0,1,,,,,0,{},5,9,"
    rows = [line.format(row).encode() for row in (1, 2, 1500)] + [b"ST16-1,\xff\xfe,x"]
    (tmp_path / "a.csv").write_bytes(b"\n".join([HEADER.encode(), *rows]) + b"\n")
    small = CONFIG.read_text().replace("rows = 1944", "rows = 1000")
    (tmp_path / "small.toml").write_text(small)
    root = tmp_path / "store"
    main(
        [
            "ingest",
            str(tmp_path / "a.csv"),
            "--store",
            str(root),
            "--config",
            str(tmp_path / "small.toml"),
        ]
    )
    capsys.readouterr()
    return root


def test_list(store, capsys):
    code, out, _ = call(capsys, "quarantine", "list", "--store", store, "--json")
    assert code == 0
    document = json.loads(out)
    assert document == listing(store, Selection()).document()
    assert document["by_reason"] == {"bad_encoding": 1, "outside_detector": 1}
    code, out, _ = call(capsys, "quarantine", "list", "--store", store)
    assert "outside_detector" in out
    assert "a.csv" in out
    code, out, _ = call(
        capsys, "quarantine", "list", "--store", store, "--reason", "bad_json", "--json"
    )
    assert json.loads(out)["records"] == 0
    assert "nothing" in call(capsys, "quarantine", "list", "--store", store, "--sensor", "X")[1]


def test_show(store, capsys):
    code, out, _ = call(capsys, "quarantine", "show", "--store", store, "--json")
    assert code == 0
    first, second = json.loads(out)["records"]
    assert first["text"] == "ST16-1,7,2026-01-05T12:00:00.000Z,0,0,0,0,1,,,,,0,1500,5,9,"
    data = (store.parent / "a.csv").read_bytes()
    assert data[first["offset"] :][: first["length"]] == first["text"].encode()
    assert data[first["offset"] - 1 :][:1] == b"\n"
    assert second["text"] is None
    assert bytes.fromhex(second["hex"]) == b"ST16-1,\xff\xfe,x"
    code, out, _ = call(capsys, "quarantine", "show", "--store", store)
    assert "row 4, offset" in out
    assert "ff fe 2c 78" in out
    code, out, _ = call(capsys, "quarantine", "show", "--store", store, "--frame", "7", "--json")
    assert len(json.loads(out)["records"]) == 1
    assert "no such record" in call(capsys, "quarantine", "show", "--store", store, "--frame", 8)[1]


def test_retry(store, capsys):
    code, out, _ = call(capsys, "quarantine", "retry", "--store", store, "--json")
    assert code == 0
    assert json.loads(out)["taken_rows"] == 0
    code, out, _ = call(
        capsys, "quarantine", "retry", "--store", store, "--config", CONFIG, "--json"
    )
    document = json.loads(out)
    assert (document["refused_rows"], document["taken_rows"], document["frames"]) == (2, 1, 1)
    assert document["sources"][0]["reasons"] == {"bad_encoding": 1}
    code, out, _ = call(capsys, "quarantine", "retry", "--store", store)
    assert "bad_encoding 1" in out


def test_mistakes(store, tmp_path, capsys):
    code, _, err = call(capsys, "quarantine", "list", "--store", tmp_path / "none")
    assert (code, "no stcal store" in err) == (3, True)
    code, _, err = call(capsys, "quarantine", "list", "--store", store, "--reason", "mood")
    assert (code, "'mood' is not one of" in err) == (2, True)
    code, out, err = call(
        capsys, "quarantine", "retry", "--store", store, "--config", tmp_path / "no.toml", "--json"
    )
    assert code == 3
    assert json.loads(out)["exit_code"] == 3


def test_ingest_with_a_mapping(tmp_path, capsys):
    mapping = tmp_path / "m.toml"
    mapping.write_text(
        """schema = "stcal.source-mapping/1"
name = "x"
format = "text"
delimiter = "semicolon"
rows = "star"
[columns]
sensor_id = { value = "ST16-1" }
frame_id = { column = "n" }
time_utc = { column = "t" }
exposure = { value = 0 }
row_px = { column = "y" }
col_px = { column = "x" }
"""
    )
    (tmp_path / "a.txt").write_text(
        "t;n;x;y\n2026-01-05 12:00:00;1;5;6\n2026-01-05 12:00:00;1;7;8\n"
    )
    options = ["--store", tmp_path / "store", "--config", CONFIG, "--json"]
    code, out, _ = call(capsys, "ingest", tmp_path / "a.txt", "--mapping", mapping, *options)
    assert code == 0
    document = json.loads(out)
    assert (document["stored_rows"], document["new_frames"], document["stars"]) == (2, 1, 2)
    code, _, err = call(
        capsys, "ingest", tmp_path / "a.txt", "--mapping", tmp_path / "no.toml", *options
    )
    assert (code, "no.toml: cannot be read" in err) == (3, True)
    mapping.write_text(mapping.read_text().replace('"y"', '"z"'))
    code, out, _ = call(capsys, "ingest", tmp_path / "a.txt", "--mapping", mapping, *options)
    assert code == 3
    assert "no column(s) z; the file has t, n, x, y" in json.loads(out)["errors"][0]
