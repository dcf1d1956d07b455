"""The command: it prints what the core returns, and ends in the right code."""

from __future__ import annotations

import json

import pytest
import telemetry_cases as cases

from stcal.cli import main

CONFIG = str(cases.ROOT / "configs" / "st16.toml")
REAL = cases.ROOT.parent / "shared" / "data" / "real"


def call(capsys, *arguments):
    code = main(["ingest", *map(str, arguments)])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_json_is_the_core_summary(tmp_path, capsys):
    path = cases.write_rows(tmp_path / "a.csv", cases.frames(20) + cases.rows(1, row_px="x"))
    _, summary = cases.run(tmp_path / "core", path)
    code, out, _ = call(capsys, path, "--store", tmp_path / "store", "--config", CONFIG, "--json")
    assert code == 0
    assert json.loads(out) == summary.document()


def test_tables(tmp_path, capsys):
    path = cases.write_rows(tmp_path / "a.csv", cases.frames(20) + cases.rows(1, row_px="x"))
    code, out, _ = call(capsys, path, path, "--store", tmp_path / "store", "--config", CONFIG)
    assert code == 0
    assert "a.csv" in out
    assert "bad_centroid" in out


@pytest.mark.parametrize("as_json", [False, True])
def test_exit_codes(tmp_path, capsys, as_json):
    good = cases.write_rows(tmp_path / "good.csv", cases.frames(2))
    bad = cases.write_rows(tmp_path / "bad.csv", cases.rows(2, star_id="?"))
    (tmp_path / "empty.csv").write_text("")
    flags = ["--json"] if as_json else []
    options = ["--store", tmp_path / "store", "--config", CONFIG, *flags]
    assert call(capsys, good, *options)[0] == 0
    code, out, err = call(capsys, bad, *options)
    assert code == 5
    assert "went to quarantine, more than the 5.0%" in err
    if as_json:
        assert json.loads(out)["exit_code"] == 5
    code, out, err = call(capsys, good, tmp_path / "empty.csv", *options)
    assert code == 3
    assert "empty.csv: the file is empty" in err
    if as_json:
        document = json.loads(out)
        assert document["exit_code"] == 3
        assert document["duplicate_frames"] == 2
    assert call(capsys, *options)[0] == 2
    missing = ["--store", tmp_path / "s", "--config", tmp_path / "no.toml", *flags]
    assert call(capsys, good, *missing)[0] == 3
    ambiguous = [*options, "--config", CONFIG]
    code, _, err = call(capsys, good, *ambiguous)
    assert code == 3
    assert "several configurations apply" in err


@pytest.mark.skipif(not REAL.exists(), reason="the measured stars of ../shared are not here")
@pytest.mark.parametrize(
    ("name", "frames", "stars", "size"),
    [("esa_tetra3", 8, 1364, (768, 1024)), ("spel_sost", 50, 3058, (1024, 1024))],
)
def test_measured_stars_ingest_cleanly(tmp_path, name, frames, stars, size):
    config = cases.config(rows=size[0], cols=size[1]).model_copy(update={"sensor_ids": [name]})
    store, summary = cases.run(tmp_path, REAL / f"{name}.csv.gz", configs=[config])
    assert summary.exit_code == 0
    assert summary.quarantined == {}
    back = store.read_frames(name)
    assert (back.n_frames, back.n_stars) == (frames, stars)
    assert (back.star_id > 0).sum() > 0.3 * stars
