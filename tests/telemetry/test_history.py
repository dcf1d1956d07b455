"""A filter's history: one row a frame, read back as it was; damage is refused."""

from dataclasses import fields, replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from conftest import simulation, st16_matcher

from stcal.errors import InputError
from stcal.matching import match
from stcal.pipeline.filter_run import EVENTS, FrameHistory, filter_fragment
from stcal.pipeline.filtering import Variant, make_filter
from stcal.telemetry.history import read_history, write_history
from stcal.times import parse_utc


@pytest.fixture(scope="module")
def run():
    """A thermal filter; some frames without stars or temperature, one with an event."""
    data, matcher = simulation(4, 51, 120), st16_matcher()
    frames = data.calibration.frames
    seen = (frames.exposure_of_star < 40) | (frames.exposure_of_star >= 50)
    counts = np.bincount(frames.exposure_of_star[seen], minlength=frames.n_exposures)
    warmth = frames.temperature_c.copy()
    warmth[5:9] = np.nan
    frames = replace(
        frames,
        temperature_c=warmth,
        star_offsets=np.concatenate(([0], np.cumsum(counts))),
        **{k: getattr(frames, k)[seen] for k in ("row_px", "col_px", "intensity", "star_id")},
    )
    baseline = match(frames, data.initial.camera, data.initial.c_sd, matcher)
    variant = Variant(parameters=("f_m", "m0_px", "n0_px", "g_y"), temperature=("f_m",))
    chosen = make_filter(variant, data.initial, matcher, thermal=True)
    _, history, _ = filter_fragment(chosen, baseline, chosen.start)
    event = history.event.copy()
    event[60] = EVENTS.index("fewer stars matched")
    return chosen, replace(history, event=event)


@pytest.fixture(scope="module")
def path(run, tmp_path_factory):
    chosen, history = run
    path = tmp_path_factory.mktemp("history") / "history.parquet"
    write_history(history, chosen, path)
    return path


def test_what_is_read_is_what_was_written(run, path):
    chosen, history = run
    again = read_history(path, chosen.n_states)
    assert np.isnan(history.nis).any()
    assert np.isnan(history.temperature_c).any()
    for field in fields(FrameHistory):
        a, b = getattr(history, field.name), getattr(again, field.name)
        assert a.dtype == b.dtype, field.name
        assert a.shape == b.shape, field.name
        assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f"), field.name


def test_a_history_read_and_written_again_is_the_same_file(run, path, tmp_path):
    chosen, _ = run
    write_history(read_history(path, chosen.n_states), chosen, tmp_path / "again.parquet")
    assert (tmp_path / "again.parquet").read_bytes() == path.read_bytes()


def test_columns_say_what_they_are(run, path):
    chosen, history = run
    table = pq.read_table(path)
    assert table.num_rows == len(history.frame_id)
    for name in ("f_m", "m0_px", "n0_px", "g_y", "f_m_per_k"):
        assert {name, f"sd_{name}"} <= set(table.column_names)
    assert "a1_rad" not in table.column_names
    f_m = table["f_m"].to_numpy()
    np.testing.assert_allclose(f_m, chosen.parameters(history.x)[:, 0], rtol=1e-15)
    np.testing.assert_allclose(table["sd_f_m"].to_numpy(), 8e-6 * history.sd[:, 0], rtol=1e-12)
    slope = 8e-6 * history.x[:, 4]
    np.testing.assert_allclose(table["f_m_per_k"].to_numpy(), slope, rtol=1e-12)
    assert table["event"].to_pylist()[59:62] == ["", "fewer stars matched", ""]
    assert table["nis"].null_count == np.isnan(history.nis).sum() > 0
    assert table["temperature_c"].null_count == 4
    lengths = [len(each) for each in table["innovations"].to_pylist()]
    assert lengths == history.innovations.tolist()
    squares = [sum(z * z for z in each) for each in table["innovations"].to_pylist()]
    used = history.arcs > 0
    np.testing.assert_allclose(np.array(squares)[used], history.nis[used], rtol=1e-9)
    assert table.schema.field("time_utc").type == pa.timestamp("ns", tz="UTC")
    first = str(table["time_utc"][0].as_py()).replace(" ", "T").replace("+00:00", "Z")
    assert abs(parse_utc(first) - int(history.t_tai_ns[0])) < 10**6


def spoilt(path, folder, change):
    """A history whose table was changed."""
    out = folder / "spoilt.parquet"
    pq.write_table(change(pq.read_table(path)), out)
    return out


def without(name):
    return lambda table: table.drop_columns([name])


def with_column(name, values):
    def change(table):
        return table.set_column(table.column_names.index(name), name, values(table))

    return change


def strings(table):
    return pa.array(["x"] * table.num_rows)


DAMAGE = {
    "no state": without("state"),
    "no innovations": without("innovations"),
    "no frame_id": without("frame_id"),
    "unknown event": with_column("event", strings),
    "event of numbers": with_column("event", lambda t: pa.array([0] * t.num_rows)),
    "event missing": with_column("event", lambda t: pa.nulls(t.num_rows, pa.string())),
    "text for numbers": with_column("arcs", strings),
    "text for states": with_column("state", strings),
    "numbers for states": with_column("state", lambda t: t["nis"]),
    "numbers for innovations": with_column("innovations", lambda t: t["nis"]),
    "text in innovations": with_column("innovations", lambda t: pa.array([["x"]] * t.num_rows)),
    "missing state": with_column(
        "state", lambda t: pa.nulls(t.num_rows, t.schema.field("state").type)
    ),
    "missing frame_id": with_column("frame_id", lambda t: pa.nulls(t.num_rows, pa.int64())),
    "missing flag": with_column("fixed", lambda t: pa.nulls(t.num_rows, pa.bool_())),
    "no rows": lambda table: table.slice(0, 0),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_damage_is_refused_naming_the_file(run, path, tmp_path, damage):
    chosen, _ = run
    file = spoilt(path, tmp_path, DAMAGE[damage])
    with pytest.raises(InputError) as caught:
        read_history(file, chosen.n_states)
    assert str(file) in str(caught.value)


def test_a_history_of_another_filter_is_refused(path):
    with pytest.raises(InputError, match="has 5 states, this filter 8"):
        read_history(path, 8)


@pytest.mark.parametrize("part", [0.0, 0.3, 0.99])
def test_a_file_cut_short_is_refused(run, path, tmp_path, part):
    chosen, _ = run
    content = path.read_bytes()
    file = tmp_path / "short.parquet"
    file.write_bytes(content[: int(part * len(content))])
    with pytest.raises(InputError, match=r"short\.parquet"):
        read_history(file, chosen.n_states)


def test_a_missing_file_is_refused(run, tmp_path):
    with pytest.raises(InputError, match=r"none\.parquet"):
        read_history(tmp_path / "none.parquet", run[0].n_states)
