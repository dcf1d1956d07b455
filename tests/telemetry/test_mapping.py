"""Foreign tables with a column mapping give the frames that the CSV of the same telemetry gives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import telemetry_cases as cases

from stcal.errors import ConfigError
from stcal.telemetry.mapping import load_mapping, mapping_from_document
from stcal.telemetry.schema import star_id_texts
from stcal.telemetry.writer import write_csv
from stcal.times import format_utc_array

ROOT = cases.ROOT / "configs" / "mappings"
VECTOR = ("q_x", "q_y", "q_z", "q_w")
RATES = ("rate_x_deg_s", "rate_y_deg_s", "rate_z_deg_s")


def stars_of(batch, exposure, column):
    """Return a list of each frame's values of one exposure."""
    offsets = batch.star_offsets
    return [
        list(column[offsets[2 * f + exposure] : offsets[2 * f + exposure + 1]])
        for f in range(batch.n_frames)
    ]


def table_of(batch):
    """Return a batch as an Arrow table, a row a frame, in units and names of another tool."""
    columns = {
        "unit": pa.array([batch.sensor_id] * batch.n_frames).dictionary_encode(),
        "number": batch.frame_id,
        "stamp": pa.array(batch.t_tai_ns, pa.int64()),
        "attitude": pa.array([list(q) for q in batch.q_si]),
        "temperature": pa.array(batch.temperature_c + 273.15),
        "chosen": pa.array(batch.best_exposure, mask=batch.best_exposure < 0),
        "dark": batch.eclipse,
    }
    for i, name in enumerate("xyz"):
        columns[f"w_{name}"] = np.radians(batch.rate_deg_s[:, i])
    names = star_id_texts(batch.star_id).to_pylist()
    for e in (0, 1):
        for name, column in (("row", batch.row_px), ("col", batch.col_px), ("i", batch.intensity)):
            columns[f"{name}{e}"] = pa.array(stars_of(batch, e, column), pa.list_(pa.float64()))
        columns[f"id{e}"] = pa.array(stars_of(batch, e, names), pa.list_(pa.string()))
    return pa.table(columns)


ARROW = {
    "schema": "stcal.source-mapping/1",
    "name": "frames",
    "format": "arrow",
    "rows": "frame",
    "columns": {
        "sensor_id": {"column": "unit"},
        "frame_id": {"column": "number"},
        "time_utc": {
            "column": "stamp",
            "time": "number",
            "time_unit": "ns",
            "epoch": "1970-01-01",
            "time_scale": "TAI",
        },
        "best_exposure": {"column": "chosen"},
        **{name: {"column": "attitude", "index": i} for i, name in enumerate(VECTOR)},
        **{name: {"column": f"w_{name[5]}", "unit": "rad/s"} for name in RATES},
        "temperature_c": {"column": "temperature", "unit": "K"},
        "eclipse": {"column": "dark"},
    },
    "stars": [
        {
            "exposure": e,
            "row_px": {"column": f"row{e}"},
            "col_px": {"column": f"col{e}"},
            "intensity": {"column": f"i{e}"},
            "star_id": {"column": f"id{e}"},
        }
        for e in (0, 1)
    ],
}


def plain(batch):
    """Return a batch without what the mappings of these tests leave out."""
    nothing = np.full((batch.n_frames, 3), np.nan)
    return replace(
        batch,
        pos_km=nothing,
        vel_km_s=nothing,
        intrusion=np.zeros(batch.n_frames, dtype=bool),
    )


def write_parquet(table, path):
    pq.write_table(table, path, row_group_size=7)


def write_file(table, path):
    with pa.ipc.new_file(path, table.schema) as writer:
        writer.write_table(table, 7)


def write_stream(table, path):
    with pa.ipc.new_stream(path, table.schema) as writer:
        writer.write_table(table, 7)


@pytest.mark.parametrize("write", [write_parquet, write_file, write_stream])
def test_a_table_of_frames(tmp_path, write):
    batch = plain(cases.batch(40))
    write(table_of(batch), tmp_path / "a.data")
    mapping = mapping_from_document(ARROW, "test")
    store, summary = cases.run(tmp_path, tmp_path / "a.data", mapping=mapping)
    assert summary.exit_code == 0
    assert summary.quarantined == {}
    back = store.read_frames("ST16-1")
    for name in ("temperature_c", "rate_deg_s"):
        a, b = getattr(back, name), getattr(batch, name)
        np.testing.assert_allclose(a, b, atol=2e-13, rtol=1e-14)
    kept = replace(batch, temperature_c=back.temperature_c, rate_deg_s=back.rate_deg_s)
    cases.assert_same_frames(back, kept)


@pytest.mark.parametrize("path", sorted(ROOT.glob("*.toml")), ids=lambda path: path.stem)
def test_the_examples_are_valid(path):
    load_mapping(path)


def yamcs_text(batch, ids):
    """Return a batch as Yamcs exports it, by the example mapping's names."""
    names = ["Time", "/ST16/FRAME_ID", "/ST16/BEST_EXPOSURE", "/ST16/Q"]
    names += [f"/ST16/RATE_{a}" for a in "XYZ"] + ["/ST16/TEMPERATURE"]
    names += [f"/ST16/E0/{n}" for n in ("ROW", "COL", "INTENSITY", "HIP")]
    names += ["/ST16/E1/STARS", *(f"/ST16/E1/{n}[{i}]" for n in ("ROW", "COL") for i in range(4))]
    lines = ["\t".join(names)]
    times = format_utc_array(batch.t_tai_ns)
    lists = [stars_of(batch, 0, c) for c in (batch.row_px, batch.col_px, batch.intensity, ids)]
    second = [stars_of(batch, 1, c) for c in (batch.row_px, batch.col_px)]
    for f in range(batch.n_frames):
        fixed = np.isfinite(batch.q_si[f, 0])
        fields = [times[f], batch.frame_id[f], ("NONE", 0, 1)[batch.best_exposure[f] + 1]]
        fields.append(f"[{', '.join(map(str, batch.q_si[f]))}]" if fixed else "")
        numbers = [*np.radians(batch.rate_deg_s[f]), batch.temperature_c[f] + 273.15]
        fields += ["" if np.isnan(x) else repr(float(x)) for x in numbers]
        fields += [f"[{', '.join(str(x) for x in listed[f])}]" for listed in lists]
        n = len(second[0][f])
        fields.append(n)
        for listed in second:
            # What lies behind the valid elements is whatever was there before.
            fields += [*listed[f], *["77.0"] * (4 - n)]
        lines.append("\t".join(str(field) for field in fields))
    return "\n".join(lines) + "\n"


def few_stars(seed=3, mean=1.2):
    """Return frames with at most four stars in exposure 1, Hipparcos stars in exposure 0."""
    batch = plain(cases.batch(30, seed, mean=mean))
    batch = batch.take(batch.stars_per_exposure.reshape(-1, 2)[:, 1] <= 4)
    exposure = batch.exposure_of_star % 2
    star_id = np.where((exposure == 0) & (batch.star_id < 2**40), batch.star_id, 0)
    intensity = np.where(exposure == 0, batch.intensity, np.nan)
    order = np.lexsort((batch.col_px, batch.row_px, -intensity, batch.exposure_of_star))
    columns = {"row_px": batch.row_px, "col_px": batch.col_px}
    columns |= {"star_id": star_id, "intensity": intensity}
    return replace(batch, **{name: column[order] for name, column in columns.items()})


def test_a_yamcs_export_with_the_example_mapping(tmp_path):
    batch = few_stars()
    path = tmp_path / "export.tsv"
    path.write_text(yamcs_text(batch, batch.star_id))
    mapping = load_mapping(ROOT / "yamcs.toml")
    store, summary = cases.run(tmp_path, path, mapping=mapping)
    assert summary.quarantined == {}
    assert summary.sources[0].format == "mapped-text"
    back = store.read_frames("ST16-1")
    flags = np.zeros(batch.n_frames, dtype=bool)
    expected = replace(batch, eclipse=flags)
    for name in ("temperature_c", "rate_deg_s"):
        a, b = getattr(back, name), getattr(batch, name)
        np.testing.assert_allclose(a, b, atol=2e-13, rtol=1e-14)
        expected = replace(expected, **{name: getattr(back, name)})
    cases.assert_same_frames(back, expected)


def test_a_mapping_and_the_telemetry_csv_give_the_same_store_content(tmp_path):
    batch = few_stars()
    batch = replace(
        batch,
        rate_deg_s=np.full((batch.n_frames, 3), np.nan),
        temperature_c=np.full(batch.n_frames, np.nan),
        eclipse=np.zeros(batch.n_frames, dtype=bool),
    )
    (tmp_path / "export.tsv").write_text(yamcs_text(batch, batch.star_id))
    write_csv([batch], tmp_path / "a.csv", decimals=None)
    mapping = load_mapping(ROOT / "yamcs.toml")
    one, _ = cases.run(tmp_path / "one", tmp_path / "export.tsv", mapping=mapping)
    two, _ = cases.run(tmp_path / "two", tmp_path / "a.csv")
    assert one.sha256("ST16-1") == two.sha256("ST16-1")


def star_table(batch):
    """Return a batch with a row a star (or a frame without any), for the example mapping."""
    counts = np.diff(batch.star_offsets[::2])
    frame = np.repeat(np.arange(batch.n_frames), np.maximum(counts, 1))
    is_star = np.repeat(counts > 0, np.maximum(counts, 1))
    place = np.cumsum(is_star) - 1
    utc = np.array([t.removesuffix("Z") for t in format_utc_array(batch.t_tai_ns)])

    def stars(column, kind):
        values = np.asarray(column)[np.maximum(place, 0)] if len(column) else np.zeros(len(frame))
        return pa.array(values, kind, mask=~is_star)

    return pa.table(
        {
            "tracker": [batch.sensor_id] * len(frame),
            "counter": batch.frame_id[frame],
            "utc": pa.array(utc.astype("datetime64[us]"), pa.timestamp("us")).take(pa.array(frame)),
            "exposure": stars(batch.exposure_of_star % 2, pa.int8()),
            "y": stars(batch.row_px, pa.float64()),
            "x": stars(batch.col_px, pa.float64()),
            "flux": stars(batch.intensity, pa.float64()),
            "hip": stars(np.where(batch.star_id < 2**40, batch.star_id, 0), pa.int64()),
        }
    )


@pytest.mark.parametrize("batch_rows", [1, 7, 16_384])
def test_rows_of_stars_wherever_a_batch_ends(tmp_path, batch_rows, monkeypatch):
    from stcal.telemetry import mapped_arrow

    decode = mapped_arrow.decode
    monkeypatch.setattr(
        mapped_arrow, "decode", lambda s, w, m: decode(s, w, m, batch_rows=batch_rows)
    )
    batch = few_stars(4, 3.0)
    table = star_table(batch)
    # A frame that contradicts itself is refused whole, wherever a batch ends.
    counter = table["counter"].to_numpy()
    last = counter[np.flatnonzero(np.diff(counter) == 0)[-1]]
    first = int(np.flatnonzero(counter == last)[0])
    stamps = table["utc"].to_pylist()
    stamps[first] = stamps[first].replace(year=2025)
    table = table.set_column(2, "utc", pa.array(stamps, pa.timestamp("us")))
    write_parquet(table, tmp_path / "a.parquet")
    mapping = load_mapping(ROOT / "parquet-stars.toml")
    store, summary = cases.run(tmp_path, tmp_path / "a.parquet", mapping=mapping)
    number = table["counter"][first].as_py()
    rows = int((table["counter"].to_numpy() == number).sum())
    assert summary.quarantined == {"inconsistent_frame": rows}
    assert [r["row"] for r in cases.records(store)] == list(range(first + 1, first + rows + 1))
    back = store.read_frames("ST16-1")
    kept = batch.take(batch.frame_id != number)
    np.testing.assert_array_equal(back.frame_id, kept.frame_id)
    np.testing.assert_array_equal(back.t_tai_ns, kept.t_tai_ns)
    np.testing.assert_array_equal(back.star_offsets, kept.star_offsets)
    np.testing.assert_array_equal(back.row_px, kept.row_px)


def test_the_example_of_frames_in_gps_time(tmp_path):
    batch = replace(few_stars(6, 2.0), eclipse=np.zeros(0, dtype=bool))
    n = batch.n_frames
    state = np.random.default_rng(0).normal(size=(2, n, 3)) * 7e6
    # GPS seconds: TAI - 19 s, counted from 1980-01-06.
    epoch = np.datetime64("1980-01-06", "ns").astype(np.int64)
    gps_s = (batch.t_tai_ns - 19 * 10**9 - epoch) / 1e9
    lists = np.split(np.arange(batch.n_stars), batch.star_offsets[2:-1:2])
    names = star_id_texts(batch.star_id).to_pylist()
    table = pa.table(
        {
            "tracker": [batch.sensor_id] * n,
            "counter": batch.frame_id.astype(np.uint32),
            "gps_s": gps_s,
            "best": pa.array(batch.best_exposure, mask=batch.best_exposure < 0),
            "q": pa.FixedSizeListArray.from_arrays(batch.q_si.ravel(), 4),
            "r_m": [list(x) for x in state[0]],
            "v_m_s": [list(x / 1000) for x in state[1]],
            "exposure": [[int(x) for x in batch.exposure_of_star[i] % 2] for i in lists],
            "row_16": [list(batch.row_px[i] * 16) for i in lists],
            "col_16": [list(batch.col_px[i] * 16) for i in lists],
            "counts": [list(batch.intensity[i]) for i in lists],
            "star": [[names[k] for k in i] for i in lists],
            "not mapped": [b"\xff"] * n,
        }
    )
    write_parquet(table, tmp_path / "a.parquet")
    mapping = load_mapping(ROOT / "parquet-frames.toml")
    store, summary = cases.run(tmp_path, tmp_path / "a.parquet", mapping=mapping)
    assert summary.quarantined == {}
    back = store.read_frames("ST16-1")
    for name in ("frame_id", "best_exposure", "star_offsets", "row_px", "col_px", "star_id"):
        np.testing.assert_array_equal(getattr(back, name), getattr(batch, name), err_msg=name)
    np.testing.assert_array_equal(back.intensity, batch.intensity)
    np.testing.assert_array_equal(back.q_si, batch.q_si)
    # A double holds these seconds to 0.24 us.
    np.testing.assert_allclose(back.t_tai_ns, batch.t_tai_ns, rtol=0, atol=250)
    np.testing.assert_allclose(back.pos_km, state[0] / 1e3, rtol=1e-15)
    np.testing.assert_allclose(back.vel_km_s, state[1] / 1e6, rtol=1e-15)


def changed(**changes):
    """Return the mapping of frames with changes, at keys joined by two underscores."""
    import copy

    document = copy.deepcopy(ARROW)
    for path, value in changes.items():
        *parents, last = path.split("__")
        place = document
        for key in parents:
            place = place[int(key) if key.isdigit() else key]
        if value is None:
            del place[last]
        else:
            place[last] = value
    return document


MISTAKES = {
    "columns.q_u is not a column of a frame": {"columns__q_u": {"column": "a"}},
    "columns.frame_id is missing": {"columns__frame_id": None},
    "columns.row_px is not a column of a frame": {"columns__row_px": {"column": "a"}},
    "unit 'F' is not one of: degC, K": {"columns__temperature_c__unit": "F"},
    "its epoch and its time_scale": {"columns__time_utc__epoch": None},
    "'yesterday' is not a date": {"columns__time_utc__epoch": "yesterday"},
    "epoch is for time_utc": {"columns__frame_id__epoch": "1970-01-01"},
    "identifier is for star_id": {"columns__frame_id__identifier": "hip"},
    "exactly one of column, columns and value": {"columns__frame_id__value": 1},
    "columns and count belong together": {
        "columns__frame_id": {"columns": "a{}"},
    },
    "they belong into [[stars]]": {"columns__q_x": {"columns": "a{}", "count": 2}},
    "scale is zero": {"columns__q_x__scale": 0.0},
    "[[stars]] is missing": {"stars": []},
    "map their columns in [columns]": {"rows": "star"},
    "one value for every star": {"stars__0__row_px": {"value": 1.0}},
    "scale and offset are for numbers": {"columns__sensor_id__scale": 2.0},
    "Extra inputs": {"stars__0__row": {"column": "a"}},
}


@pytest.mark.parametrize("said", MISTAKES)
def test_mistakes_in_a_mapping_are_named(said):
    with pytest.raises(ConfigError) as error:
        mapping_from_document(changed(**MISTAKES[said]), "m.toml")
    assert said in str(error.value)
    assert str(error.value).startswith("m.toml:")


TABLES = {
    "no column(s) number, dark": lambda t: t.drop_columns(["number", "dark"]),
    "'stamp' is struct": lambda t: t.set_column(2, "stamp", pa.array([{"a": 1}] * t.num_rows)),
    "'row0' is int64, not a list": lambda t: t.set_column(
        t.column_names.index("row0"), "row0", t["number"]
    ),
}


@pytest.mark.parametrize("said", TABLES)
def test_tables_that_do_not_fit_are_refused(tmp_path, said):
    write_parquet(TABLES[said](table_of(plain(cases.batch(5)))), tmp_path / "a.parquet")
    mapping = mapping_from_document(ARROW, "test")
    store, summary = cases.run(tmp_path, tmp_path / "a.parquet", mapping=mapping)
    assert summary.exit_code == 3
    assert said in summary.errors[0]
    assert str(tmp_path / "a.parquet") in summary.errors[0]
    assert store.sensors() == []


def test_files_that_are_no_tables_are_refused(tmp_path):
    mapping = mapping_from_document(ARROW, "test")
    write_parquet(table_of(plain(cases.batch(5))), tmp_path / "whole.parquet")
    whole = (tmp_path / "whole.parquet").read_bytes()
    import gzip

    contents = {
        "text.parquet": (b"a,b\n1,2\n", "neither a Parquet nor an Arrow IPC file"),
        "cut.parquet": (whole[: len(whole) // 2], "damaged"),
        "packed.parquet": (gzip.compress(whole), "unpack it first"),
        "bent.parquet": (whole[:-30] + b"\xff" * 10 + whole[-20:], "damaged"),
        "empty.parquet": (b"", "is empty"),
    }
    for name, (content, said) in contents.items():
        (tmp_path / name).write_bytes(content)
        store, summary = cases.run(tmp_path, tmp_path / name, mapping=mapping)
        assert said in summary.errors[0], name
        assert name in summary.errors[0]
        assert store.sensors() == []


def test_a_folder_gives_the_files_of_the_mappings_format(tmp_path):
    folder = tmp_path / "tables"
    folder.mkdir()
    table = table_of(plain(cases.batch(20)))
    write_parquet(table.slice(0, 10), folder / "a.parquet")
    write_file(table.slice(10), folder / "b.arrow")
    (folder / "notes.csv").write_text("not for this mapping")
    mapping = mapping_from_document(ARROW, "test")
    store, summary = cases.run(tmp_path, folder, mapping=mapping)
    assert [source.path.name for source in summary.sources] == ["a.parquet", "b.arrow"]
    assert store.read_frames("ST16-1").n_frames == 20
