"""A clock that is decades off, and telemetry across leap seconds."""

from datetime import UTC, datetime

import numpy as np
import pytest
from chaos_driver import stcal
from chaos_scene import LONG, ROOT

from stcal.config import load_config
from stcal.pipeline import describe
from stcal.telemetry.ingest import ingest
from stcal.telemetry.packet_layout import load_layout
from stcal.telemetry.packet_writer import encode_packets
from stcal.telemetry.store import Store
from stcal.telemetry.writer import write_csv, write_jsonl
from stcal.times import format_utc_array, parse_utc

CONFIG = load_config(ROOT / "configs" / "st16.toml")
HEADER = "sensor_id,frame_id,time_utc,best_exposure,q_x,q_y,q_z,q_w,rate_x_deg_s,rate_y_deg_s,"
HEADER += "rate_z_deg_s,temperature_c,exposure,row_px,col_px,intensity,star_id\n"
TIMES = (
    "2016-12-31T23:59:59.500Z", "2016-12-31T23:59:60.000Z", "2016-12-31T23:59:60.500Z",
    "2016-12-31T23:59:60.999Z", "2017-01-01T00:00:00.000Z", "2017-01-01T00:00:00.500Z",
)  # fmt: skip


@pytest.mark.parametrize("year", [1970, 2100])
@pytest.mark.parametrize("stage", ["fit", "validate", "build"] if LONG else ["fit"])
def test_results_do_not_depend_on_the_clock(scene, monkeypatch, stage, year):
    class Clock(datetime):
        @classmethod
        def now(cls, tz=None):
            return datetime(year, 1, 1, tzinfo=tz or UTC)

    monkeypatch.setattr(describe, "datetime", Clock)
    monkeypatch.setattr("time.time", Clock.now().timestamp)
    scene.reset(stage)
    ended = stcal(scene.command(stage))
    assert ended.code == 0, ended
    if stage == "fit":
        assert f'"created_utc": "{year}-01-01' in (scene.work / "fit" / "fit.json").read_text()
    scene.end(stage)


def stored(folder, path, **options):
    store = Store.open(folder, create=True)
    return store, ingest([path], store, [CONFIG], **options)


def leap_frames(tmp_path, times=TIMES):
    path = tmp_path / "leap.csv"
    rows = [f"ST16-1,{f},{time},0,0,0,0,1,,,,20,{e},100.5,200.25,1000,\n"
            for f, time in enumerate(times) for e in (0, 1)]  # fmt: skip
    path.write_text(HEADER + "".join(rows))
    return stored(tmp_path / "store", path)


def test_leap_seconds_come_back_as_they_went(tmp_path):
    store, summary = leap_frames(tmp_path)
    assert (summary.exit_code, summary.counts.new_frames) == (0, len(TIMES))
    frames = store.read_frames("ST16-1")
    assert frames.t_tai_ns.tolist() == [parse_utc(time) for time in TIMES]
    assert (np.diff(frames.t_tai_ns)[:2] == 500_000_000).all()
    days = sorted(path.name for path in (store.root / "frames").glob("*/*"))
    assert [day[-10:] for day in days] == ["2016-12-31", "2017-01-01"]
    write_csv([frames], tmp_path / "b.csv")
    write_jsonl([frames], tmp_path / "b.jsonl")
    layout = load_layout(ROOT / "configs" / "packets" / "st16.toml")
    (tmp_path / "b.ccsds").write_bytes(encode_packets(layout, frames))
    for name in ("b.csv", "b.jsonl", "b.ccsds"):
        packets = {"packets": layout} if name == "b.ccsds" else {}
        again, _ = stored(tmp_path / f"of-{name}", tmp_path / name, **packets)
        found = again.read_frames("ST16-1").t_tai_ns
        assert np.abs(found - frames.t_tai_ns).max() <= (60 if packets else 0), name
    assert tuple(format_utc_array(frames.t_tai_ns)) == TIMES


def test_no_leap_second_where_there_was_none(tmp_path):
    _, summary = leap_frames(tmp_path, ("2015-12-31T23:59:60.000Z", "2016-12-31T23:58:60.000Z"))
    assert summary.counts.new_frames == 0
    assert summary.counts.quarantined_rows == 4
