"""A store from elsewhere: it may not lead out of its folder, crash kernels or fill the memory."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from stcal.cli import main
from stcal.config import load_config
from stcal.errors import InputError
from stcal.telemetry.ingest import ingest
from stcal.telemetry.parquet import reading
from stcal.telemetry.store import Store

ROOT = Path(__file__).parents[2]
HEADER = "sensor_id,frame_id,time_utc,best_exposure,q_x,q_y,q_z,q_w,rate_x_deg_s,rate_y_deg_s,"
HEADER += "rate_z_deg_s,temperature_c,exposure,row_px,col_px,intensity,star_id\n"


def telemetry(path, sensors=("ST16-1",), frames=40):
    lines = [
        f"{sensor},{f},2026-01-05T12:{f:02d}:00Z,0,0,0,0,1,,,,20,{e},{100 + 7 * k}.5,{200 + f}.25,"
        f"{1000 + k},HIP {27989 + k}\n"
        for sensor in sensors
        for f in range(frames)
        for e in (0, 1)
        for k in range(4)
    ]
    path.write_text(HEADER + "".join(lines))
    return path


def filled(folder, **options):
    store = Store.open(folder / "store", create=True)
    config = load_config(ROOT / "configs" / "st16.toml")
    config = config.model_copy(update={"sensor_ids": ["*"]})
    return store, ingest([telemetry(folder / "a.csv", **options)], store, [config])


NAMES = ["../../x", "/etc/x", "..", "CON", "a/b\\c", "[/red]", "<script>", "%2e%2e", "=1+1"]


def test_names_of_sensors_stay_within_the_store(tmp_path):
    inside = tmp_path / "deep" / "er"
    inside.mkdir(parents=True)
    store, summary = filled(inside, sensors=NAMES, frames=2)
    assert summary.counts.new_frames == 2 * len(NAMES)
    assert store.sensors() == sorted(NAMES)
    outside = [p for p in tmp_path.rglob("*") if p.is_file() and inside not in p.parents]
    assert outside == []
    folders = list((store.root / "frames").iterdir())
    assert len(folders) == len(NAMES)


@pytest.mark.parametrize("where", ["frames", "frames/sensor=ST16-1", "quarantine", "configs"])
def test_a_link_to_a_folder_is_not_written_through(tmp_path, where):
    store, _ = filled(tmp_path)
    outside = tmp_path / "outside"
    outside.mkdir()
    place = store.root / where
    if place.exists():
        place.rename(tmp_path / "moved")
    place.symlink_to(outside)
    with pytest.raises(InputError, match="symbolic link"), store.lock():
        pass
    assert list(outside.iterdir()) == []


def test_a_lock_that_is_a_link_empties_nothing(tmp_path):
    store, _ = filled(tmp_path)
    precious = tmp_path / "precious"
    precious.write_text("kept")
    (store.root / ".lock").unlink()
    (store.root / ".lock").symlink_to(precious)
    with pytest.raises(InputError, match="cannot be locked"), store.lock():
        pass
    assert precious.read_text() == "kept"


def test_a_store_that_vanishes_is_not_begun_anew(tmp_path):
    store, _ = filled(tmp_path)
    with pytest.raises(InputError, match="moved or removed"), store.lock():
        store.root.rename(tmp_path / "elsewhere")


def fragment(store):
    return next(store.root.glob("frames/*/*/frames.parquet"))


def test_flipped_bits_of_a_fragment_are_seen(tmp_path):
    """Without checksums of pages three of four flips decode silently to other numbers."""
    store, _ = filled(tmp_path)
    path, content = fragment(store), fragment(store).read_bytes()
    whole, rng = store.sha256("ST16-1"), np.random.default_rng(0)
    said = []
    for place in rng.integers(0, len(content), 300).tolist():
        damaged = bytearray(content)
        damaged[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(bytes(damaged))
        try:
            assert store.sha256("ST16-1") == whole, place
        except InputError as error:
            said.append(str(error))
    assert len(said) > 150
    assert all(str(path) in one for one in said)
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError, match="damaged"):
        store.read_frames("ST16-1")


def lists(table, name, change):
    values = table[name].to_pylist()
    values[0] = change(values[0])
    column = pa.array(values, table.schema.field(name).type)
    return table.set_column(table.column_names.index(name), table.schema.field(name), column)


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("row_px", lambda v: v[:-1], "other lengths"),
        ("star_id", lambda v: [*v, None], "other lengths"),
        ("exposure", lambda v: [7, *v[1:]], "exposures"),
        ("exposure", lambda v: [-1, *v[1:]], "exposures"),
        ("exposure", lambda v: v[::-1], "exposures"),
        ("col_px", lambda v: [float("nan"), *v[1:]], "no number"),
        ("row_px", lambda v: [None, *v[1:]], "no number"),
        ("star_id", lambda v: ["HIP x", *v[1:]], "no identifier"),
        ("sensor_id", lambda v: "ST16-2", "another sensor"),
        ("best_exposure", lambda v: 100, "best_exposure"),
    ],
)
def test_a_fragment_that_ingest_would_not_write(tmp_path, name, change, said):
    store, _ = filled(tmp_path)
    path = fragment(store)
    pq.write_table(lists(pq.ParquetFile(path).read(), name, change), path)
    with pytest.raises(InputError, match=said) as error:
        store.read_frames("ST16-1")
    assert str(path) in str(error.value)


def test_a_parquet_bomb_is_refused_before_it_unfolds(tmp_path):
    path = tmp_path / "bomb.parquet"
    column = pa.array(np.zeros(60_000_000, np.int8))
    pq.write_table(pa.table({"a": column}), path, compression="zstd", row_group_size=10**9)
    assert path.stat().st_size < 300_000
    with pytest.raises(InputError, match="60000000 values"), reading(path, "fragment") as file:
        file.read()


def test_names_do_not_steer_the_terminal(tmp_path, capsys):
    telemetry(tmp_path / "a.csv", frames=1)
    frame = {"sensor_id": "\x1b[2J[/red]", "frame_id": 1, "time_utc": "2026-01-05T12:00:00Z",
             "best_exposure": None, "quaternion": None, "rate_deg_s": None,
             "temperature_c": None, "exposures": []}  # fmt: skip
    (tmp_path / "[b].jsonl").write_text(json.dumps(frame) + "\n")
    store = ["--store", str(tmp_path / "store")]
    config = ["--config", str(ROOT / "configs" / "st16.toml")]
    main(["ingest", str(tmp_path), *store, *config])
    for command in (["list"], ["show"], ["retry"]):
        assert main(["quarantine", *command, *store]) == 0
    out, err = capsys.readouterr()
    assert "\x1b" not in out + err
    assert "\\x1b[2J[/red]" in out
