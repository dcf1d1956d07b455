"""Packets through the whole ingest: the frames of the CSV, the quarantine, the summary."""

from __future__ import annotations

import gzip
import hashlib
from dataclasses import replace

import numpy as np
import pytest
import telemetry_cases as cases
from hypothesis import given, settings
from hypothesis import strategies as st
from packet_cases import EXAMPLE, as_sent, decode, packet, small_layout, star_packet, stars_of

from stcal.errors import InputError
from stcal.frames import FrameBatch
from stcal.telemetry.cosmos import log_of
from stcal.telemetry.packet_decode import column_of
from stcal.telemetry.packet_fields import PacketField
from stcal.telemetry.packet_layout import load_layout
from stcal.telemetry.packet_stars import raw_numbers, star_codes
from stcal.telemetry.packet_writer import encode_packets
from stcal.telemetry.retry import retry
from stcal.telemetry.writer import write_csv

LAYOUT = load_layout(EXAMPLE)


def stored(tmp_path, content, layout=LAYOUT, name="downlink.ccsds", **options):
    tmp_path.mkdir(exist_ok=True)
    path = tmp_path / name
    path.write_bytes(content)
    return cases.run(tmp_path, path, packets=layout, **options)


def assert_alike(a: FrameBatch, b: FrameBatch, time_ns: float = 60.0) -> None:
    """Assert that frames are equal but for rounding."""
    for name in ("frame_id", "best_exposure", "eclipse", "intrusion", "star_offsets", "star_id"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    assert np.abs(a.t_tai_ns - b.t_tai_ns).max() <= time_ns
    for name in ("q_si", "temperature_c", "pos_km", "vel_km_s"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-12, atol=1e-12)
    for name in ("rate_deg_s", "row_px", "col_px", "intensity"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


def test_packets_and_csv_of_the_same_frames_give_the_same_frames(tmp_path):
    frames = as_sent(cases.batch(80, seed=4, sensor_id="ST16-2"))
    write_csv([frames], tmp_path / "a.csv.gz", None)
    text, _ = cases.run(tmp_path / "text", tmp_path / "a.csv.gz")
    raw = encode_packets(LAYOUT, frames)
    packets, summary = stored(tmp_path, raw)
    assert summary.exit_code == 0
    assert summary.counts.frames == 80
    assert_alike(packets.read_frames("ST16-2"), text.read_frames("ST16-2"))
    # Compressed, and as a log, they are the same to the last bit.
    for name, content in (("b.ccsds.gz", gzip.compress(raw)), ("c.bin", as_log(raw))):
        again, _ = stored(tmp_path / name, content, name=name)
        assert again.read_frames("ST16-2").n_frames == 80
        cases.assert_same_frames(again.read_frames("ST16-2"), packets.read_frames("ST16-2"))


def as_log(raw: bytes) -> bytes:
    """Return packets back to back as a log."""
    pieces, place = [], 0
    while place < len(raw):
        total = int.from_bytes(raw[place + 4 : place + 6], "big") + 7
        pieces.append((10**18 + place, raw[place : place + total]))
        place += total
    return log_of(pieces, "SAT", "STARS", received_ns=3)


@settings(max_examples=100, deadline=None)
@given(cases.batches(sensor_id="ST16-3"))
def test_any_frames_there_and_back(frames):
    frames = replace(
        frames,
        frame_id=frames.frame_id % 2**32,
        temperature_c=np.clip(frames.temperature_c, -300, 300),
        pos_km=np.clip(frames.pos_km, -1e5, 1e5),
        vel_km_s=np.clip(frames.vel_km_s, -1e3, 1e3),
    )
    expected = as_sent(frames)
    _, (block, *_), records = decode(LAYOUT, encode_packets(LAYOUT, frames))
    assert not records
    first = block.frame_index[np.flatnonzero(np.diff(block.run, prepend=-1))]
    assert block.columns["frame_id"].values[first].tolist() == frames.frame_id.tolist()
    assert np.abs(block.columns["time_utc"].values[first] - frames.t_tai_ns).max() <= 60
    for name, column in (("q_x", expected.q_si[:, 0]), ("rate_z_deg_s", expected.rate_deg_s[:, 2])):
        np.testing.assert_allclose(block.columns[name].values[first], column, rtol=0, atol=1e-9)
    is_star = ~block.columns["exposure"].empty
    exposure = block.columns["exposure"].values[is_star]
    np.testing.assert_array_equal(exposure, expected.exposure_of_star % 2)
    for name in ("row_px", "col_px", "intensity", "star_id"):
        np.testing.assert_array_equal(block.columns[name].values[is_star], getattr(expected, name))


hip = st.integers(0, 200_000)
tycho = st.builds(
    lambda a, b, c: 2**40 + (a * 100_000 + b) * 10 + c,
    st.integers(1, 9537),
    st.integers(1, 12_121),
    st.integers(1, 3),
)


@given(st.lists(hip | tycho))
def test_identifiers_there_and_back(codes):
    array = np.array(codes, np.int64)
    assert star_codes(raw_numbers(array, "hip-tyc"), "hip-tyc").tolist() == codes


def test_every_number_is_an_identifier_or_is_none():
    raw = np.array(
        [0, 5, 200_000, 200_001, 2**31, 2**31 | 1 << 17 | 1 << 3 | 1, 2**32 - 1], np.uint64
    )
    tycho = 2**40 + (1 * 100_000 + 1) * 10 + 1
    assert star_codes(raw, "hip-tyc").tolist() == [0, 5, 200_000, -1, -1, tycho, -1]
    assert star_codes(raw, "hip").tolist() == [0, 5, 200_000, -1, -1, -1, -1]
    with pytest.raises(ValueError, match="hip cannot say"):
        raw_numbers(np.array([tycho]), "hip")


@pytest.mark.parametrize(
    ("text", "raw", "value"),
    [
        ({"name": "temperature_c", "type": "u16", "scale": 0.5, "unit": "K"}, 600, 26.85),
        ({"name": "temperature_c", "type": "i8", "offset": 0.25, "unit": "degC"}, 0xFF, -0.75),
        ({"name": "rate_x_deg_s", "type": "u8", "unit": "rad/s"}, 2, np.degrees(2.0)),
        ({"name": "pos_x_km", "type": "i16", "unit": "m"}, 0xFFFF, -1e-3),
        ({"name": "vel_x_km_s", "type": "f32", "unit": "m/s"}, 0x44FA0000, 2.0),
        ({"name": "q_x", "type": "f64"}, 0x3FE0000000000000, 0.5),
        ({"name": "q_x", "type": "f64"}, 0x7FF8000000000000, "bad"),
        ({"name": "q_x", "type": "f64", "empty": np.nan}, 0x7FF8000000000000, "empty"),
        ({"name": "q_x", "type": "f32", "empty": np.nan}, 0x7F800000, "bad"),
        ({"name": "q_x", "type": "i8", "empty": -128}, 0x80, "empty"),
        ({"name": "best_exposure", "type": "u2", "empty": 3}, 3, "empty"),
        ({"name": "frame_id", "type": "u64"}, 2**63, "bad"),
        ({"name": "frame_id", "type": "i64"}, 2**64 - 5, -5),
        ({"name": "eclipse", "type": "u8"}, 2, "bad"),
    ],
)
def test_raw_numbers_become_the_columns_values(text, raw, value):
    column = column_of(PacketField(**text), np.array([raw], np.uint64))
    assert column.bad[0] == (value == "bad")
    assert column.empty[0] == (value == "empty")
    if isinstance(value, str):
        assert np.isnan(column.values[0]) or column.values[0] == 0
    else:
        assert column.values[0] == pytest.approx(value, rel=1e-12)


def test_damage_and_faults_go_to_quarantine_with_their_bytes(tmp_path):
    packets = [star_packet(n, stars_of(n)) for n in range(8)]
    packets[1] = packets[1][:-1] + bytes([packets[1][-1] ^ 1])
    packets[2] = star_packet(2, [(0xFFFF, 8, 5), (8, 8, 250_000), (16, 16, 27989)])
    packets.insert(6, b"lost")
    content = b"".join(packets)
    store, summary = stored(tmp_path, content, small_layout())
    records = store.quarantine().to_pylist()
    assert {r["code"]: r["raw"] for r in records} == {
        "packet_crc": packets[1],
        "outside_detector": packets[2],
        "bad_star_id": packets[2],
        "packet_sync": b"lost",
    }
    for record in records:
        assert content[record["offset"] :][: record["length"]] == record["raw"]
        assert record["source_sha256"] == hashlib.sha256(content).hexdigest()
    frames = store.read_frames("ST16-1")
    assert frames.frame_id.tolist() == [0, 2, 3, 4, 5, 6, 7]
    assert frames.take(np.array([1])).star_id.tolist() == [27989]
    assert summary.counts.quarantined_rows == 4
    (source,) = summary.document()["sources"]
    assert source["packets"]["apids"][0]["lost"] == 1
    assert source["format"] == "ccsds"
    assert any(
        "packets lost by the sequence count: 1, gaps: 1" in warning
        for warning in source["warnings"]
    )


def test_bad_values_of_frames(tmp_path):
    """Times before 1972 and a sensor without a configuration."""
    layout = small_layout(apids='{ "ST16-1" = 321, "OTHER-1" = 322 }')
    early = packet(bytes(6) + star_packet(1, [])[12:-2])
    packets = [early, star_packet(2, stars_of(2)), star_packet(3, [], apid=322)]
    store, summary = stored(tmp_path, b"".join(packets), layout)
    assert summary.document()["quarantined"] == {"unknown_sensor": 1, "bad_time": 1}
    assert store.read_frames("ST16-1").frame_id.tolist() == [2]


MATCHES = """
  { name = "m", type = "u8" },
  { list = "matches", name = "ids", count = "m", maximum = 9, fields = [
    { name = "star", type = "i8" },
    { name = "star_id", type = "u32", encoding = "hip-tyc" },
  ], of = "stars", first_index = 1 },
"""


def with_matches(frame, stars, matches):
    data = star_packet(frame, stars)[6:-2] + bytes([len(matches)])
    return packet(
        data + b"".join(bytes([star % 256]) + code.to_bytes(4, "big") for star, code in matches)
    )


def test_matches_point_into_the_list_of_stars(tmp_path):
    stars = [(8 * k, 8 * k, 0) for k in range(1, 4)]
    packets = [
        with_matches(0, stars, [(3, 100), (1, 101)]),
        with_matches(1, stars, [(4, 100)]),
        with_matches(2, stars, [(0, 100)]),
        with_matches(3, stars, [(2, 100), (2, 101)]),
        with_matches(4, stars, [(-1, 100)]),
        with_matches(5, [], []),
        with_matches(6, stars, [(2, 102)]),
    ]
    store, summary = stored(tmp_path, b"".join(packets), small_layout(MATCHES))
    assert summary.document()["quarantined"] == {"match_index": 4}
    frames = store.read_frames("ST16-1")
    assert frames.frame_id.tolist() == [0, 5, 6]
    place = np.argsort(frames.row_px[:3])
    assert frames.star_id[:3][place].tolist() == [101, 0, 100]
    assert frames.star_id[3:][np.argsort(frames.row_px[3:])].tolist() == [0, 102, 0]
    assert [r["raw"] for r in store.quarantine().to_pylist()] == packets[1:5]


def test_an_exposure_a_packet_makes_one_frame(tmp_path):
    layout = small_layout('  { name = "which", type = "u8" },', exposure='exposure = "which"')
    packets = []
    for n in range(4):
        for which in (1, 0):
            data = star_packet(n, [(8 * which + 8, 8, 0)])[6:-2] + bytes([which])
            packets.append(packet(data, sequence=2 * n + which))
    store, summary = stored(tmp_path, b"".join(packets), layout)
    frames = store.read_frames("ST16-1")
    assert frames.n_frames == 4
    assert frames.stars_per_exposure.tolist() == [1] * 8
    assert frames.row_px.tolist() == [1.0, 2.0] * 4
    assert summary.counts.quarantined_rows == 0


def test_packets_that_come_twice_are_duplicates(tmp_path):
    frames = cases.batch(20, sensor_id="ST16-2")
    raw = encode_packets(LAYOUT, frames)
    store, summary = stored(tmp_path, raw + raw)
    assert (summary.counts.new_frames, summary.counts.duplicate_frames) == (20, 20)
    (counts,) = summary.document()["sources"][0]["packets"]["apids"]
    assert (counts["packets"], counts["duplicates"], counts["lost"]) == (40, 20, 0)
    before = store.sha256("ST16-2")
    again, _ = stored(tmp_path, raw + raw)
    assert again.sha256("ST16-2") == before


def test_the_layout_is_kept_and_text_is_still_text(tmp_path):
    path = cases.write_rows(tmp_path / "a.csv", cases.frames(3))
    store, summary = cases.run(tmp_path, path, packets=LAYOUT)
    assert [source.format for source in summary.sources] == ["csv"]
    (kept,) = (store.root / "layouts").iterdir()
    assert kept.read_bytes() == EXAMPLE.read_bytes()
    assert kept.stem == hashlib.sha256(EXAMPLE.read_bytes()).hexdigest()


def test_a_folder_and_old_logs(tmp_path):
    folder = tmp_path / "downlink"
    folder.mkdir()
    (folder / "a.ccsds").write_bytes(encode_packets(LAYOUT, cases.batch(3)))
    (folder / "old.bin").write_bytes(b"COSMOS4_" + bytes(200))
    store, summary = cases.run(tmp_path, folder, packets=LAYOUT)
    assert store.read_frames("ST16-1").n_frames == 3
    assert ["COSMOS 4" in error for error in summary.errors] == [True]
    assert "old.bin" in summary.errors[0]


def test_packets_without_a_layout_are_refused_as_before(tmp_path):
    path = tmp_path / "a.ccsds"
    path.write_bytes(encode_packets(LAYOUT, cases.batch(3)))
    _, summary = cases.run(tmp_path, path)
    assert "binary" in summary.errors[0]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"frame_id": np.array([2**32])}, "frame_id: a value from 4.29497e[+]09"),
        ({"sensor_id": "XY-1"}, "no APID for sensor XY-1"),
        ({"t_tai_ns": np.array([9 * 10**18])}, "outside what the CUC code's coarse can count"),
        ({"row_px": np.full(6, 5000.0)}, "stars_[01].row_px: a value"),
    ],
)
def test_what_packets_cannot_say(change, said):
    frames = cases.batch(1, seed=1)
    if "row_px" in change:
        change = {"row_px": np.full(frames.n_stars, 5000.0)}
        assert frames.n_stars
    with pytest.raises(InputError, match=said):
        encode_packets(LAYOUT, replace(frames, **change))


def test_more_stars_than_a_list_holds():
    frames = cases.batch(2, mean=40.0)
    with pytest.raises(InputError, match="holds 32 entries, a frame has"):
        encode_packets(LAYOUT, frames)


def test_a_file_of_something_else_is_an_error_not_quarantine(tmp_path):
    store, summary = stored(tmp_path, np.random.default_rng(0).bytes(5000))
    assert "no packet of the layout 'ST-16 star frame'" in summary.errors[0]
    assert store.quarantine().num_rows == 0
    # But a packet that came damaged is kept.
    bad = bytearray(encode_packets(LAYOUT, cases.batch(1)))
    bad[-1] ^= 1
    store, summary = stored(tmp_path, bytes(bad))
    assert summary.document()["quarantined"] == {"packet_crc": 1}


def test_refused_packets_are_tried_again(tmp_path):
    """With the configuration of the other sensor; what is damaged stays as it was."""
    layout = small_layout(apids='{ "ST16-1" = 321, "OTHER-1" = 322 }')
    packets = [star_packet(n, stars_of(n), apid=322 - n % 2) for n in range(1, 7)]
    packets[2] = packets[2][:-1] + bytes([packets[2][-1] ^ 1])
    packets.insert(2, b"lost bytes")
    store, _ = stored(tmp_path, b"".join(packets), layout)
    assert store.quarantine()["code"].to_pylist() == [
        "unknown_sensor",
        "packet_sync",
        "packet_crc",
        "unknown_sensor",
        "unknown_sensor",
    ]
    other = cases.config().model_copy(update={"name": "other", "sensor_ids": ["OTHER-*"]})
    (result,) = retry(store, [cases.config(), other])
    assert result.note is None
    assert store.read_frames("OTHER-1").frame_id.tolist() == [2, 4, 6]
    left = store.quarantine().to_pylist()
    assert [record["code"] for record in left] == ["packet_sync", "packet_crc"]
    assert [record["raw"] for record in left] == [packets[2], packets[3]]
    assert [record["offset"] for record in left] == [
        len(packets[0] + packets[1]),
        len(b"".join(packets[:3])),
    ]
    # What was taken is what an ingest with both configurations gives.
    whole, _ = stored(
        tmp_path / "whole", b"".join(packets), layout, configs=[cases.config(), other]
    )
    cases.assert_same_frames(store.read_frames("OTHER-1"), whole.read_frames("OTHER-1"))
