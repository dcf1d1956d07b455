"""space-packet-parser decodes the same streams with the XTCE definition to the same values."""

from __future__ import annotations

import io
import warnings

import numpy as np
import pytest
import space_packet_parser as spp
from packet_cases import EXAMPLE, small_layout
from telemetry_cases import batch

from stcal.errors import InputError
from stcal.telemetry.packet_decode import decode_packets, find_places, make_program, physical
from stcal.telemetry.packet_layout import load_layout
from stcal.telemetry.packet_stream import frame_blocks
from stcal.telemetry.packet_writer import encode_packets
from stcal.telemetry.packet_xtce import xtce

ODD = """
  { name = "after", type = "u3" },
  { name = "m", type = "u16", byte_order = "little" },
  { name = "spare_f64", type = "f64" },
  { name = "little_f32", type = "f32", byte_order = "little" },
  { name = "signed", type = "i13" },
  { list = "stars", name = "b", count = "m", maximum = 3, fields = [
    { name = "row_px", type = "u24", byte_order = "little", scale = 1e-3, unit = "px" },
    { name = "col_px", type = "i33", scale = 1e-6, offset = -0.5, unit = "px" },
    { name = "intensity", type = "f32", unit = "counts", empty = nan },
  ], exposure = 1, always_full = true },
"""


def definition(tmp_path, text):
    path = tmp_path / "layout.xml"
    path.write_text(text)
    assert spp.validate_xtce(path, level="all").errors == []
    return spp.load_xtce(path)


def parsed(found, raw):
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # bits left over are a warning
        return [found.parse_bytes(one) for one in spp.ccsds_generator(io.BytesIO(raw))]


def ours(layout, raw):
    """Return our columns, and the raw time parts, of a stream."""
    program = make_program(layout)
    (block,) = frame_blocks(layout, program, iter([raw]), is_log=False)
    assert not block.damage
    places = find_places(program, block.data, block.start, block.total)
    assert not places.fits.any()
    return block, places, decode_packets(layout, block.data, places)


def check_lists(layout, decoded, theirs, value_of):
    """Compare every entry that the decoder takes as a column without conversion."""
    for one in layout.lists:
        names = [
            name for name in decoded.lists[one.name] if name in ("row_px", "col_px", "intensity")
        ]
        k = 0
        for i, packet in enumerate(theirs):
            for n in range(int(decoded.count[one.name][i])):
                for name in names:
                    mine = decoded.lists[one.name][name].values[k]
                    theirs_ = value_of(packet, one, n, name)
                    assert mine == pytest.approx(theirs_, rel=1e-12, nan_ok=True), (i, n, name)
                k += 1
        assert k == len(decoded.lists[one.name]["row_px" if one.holds == "stars" else "star"])


def check_scalars(layout, decoded, theirs):
    for name in ("frame_id", "temperature_c"):
        mine = decoded.scalars[name].values
        assert mine == pytest.approx([packet[name] for packet in theirs], rel=1e-12)


def frames_for(layout):
    frames = batch(60, seed=3, sensor_id="ST16-2", mean=1.5)
    most = min(one.maximum for one in layout.lists)
    keep = (frames.stars_per_exposure.reshape(-1, 2) <= most).all(axis=1)
    frames = frames.take(keep)
    frames.temperature_c[np.isnan(frames.temperature_c)] = 20.0
    frames.intensity[np.isnan(frames.intensity)] = 1.0
    return frames


@pytest.mark.parametrize("more", ["", ODD], ids=["bytes", "odd bits, full lists, little-endian"])
def test_expanded_lists(tmp_path, more):
    layout = small_layout(more)
    raw = encode_packets(layout, frames_for(layout))
    theirs = parsed(definition(tmp_path, xtce(layout, "expanded")), raw)
    _, _, decoded = ours(layout, raw)
    assert len(theirs) == len(decoded.t_tai_ns) > 30
    check_scalars(layout, decoded, theirs)
    check_lists(layout, decoded, theirs, lambda p, one, n, name: p[f"{one.name}_{n:02d}_{name}"])
    assert sum(decoded.count["stars"]) > 20


def test_the_example_with_lists_as_binary(tmp_path):
    layout = load_layout(EXAMPLE)
    raw = encode_packets(layout, batch(40, seed=5, sensor_id="ST16-2"))
    found = definition(tmp_path, xtce(layout))
    theirs = parsed(found, raw)
    block, places, decoded = ours(layout, raw)

    def entry(packet, one, n, name):
        size = one.stride // 8
        piece = bytes(packet[one.name])[n * size : (n + 1) * size]
        value = found.parse_bytes(piece, root_container_name=f"{one.name}_entry")
        return value[f"{one.name}_{name}"]

    check_lists(layout, decoded, theirs, entry)
    for field in layout.scalars:
        mine = decoded.scalars[field.name]
        there = ~mine.empty
        factor, shift = field.conversion
        value = np.array([packet[field.name] for packet in theirs], dtype=np.float64)
        expected = factor * value[there] + shift
        assert mine.values[there] == pytest.approx(expected, rel=1e-12), field.name
    # The matches point at the stars that have the identifiers.
    k = 0
    for i, packet in enumerate(theirs):
        n = int(decoded.count["matches_0"][i])
        for m in range(n):
            one = layout.lists[1]
            star = int(entry(packet, one, m, "star"))
            first = int(decoded.count["stars_0"][:i].sum())
            code = decoded.lists["stars_0"]["star_id"].values[first + star]
            assert decoded.lists["matches_0"]["star_id"].values[k] == code > 0
            k += 1
    assert k > 20
    assert len(block.start) == len(places.fits) == 40


def test_time_codes_are_the_raw_parts(tmp_path):
    layout = small_layout()
    frames = frames_for(layout)
    theirs = parsed(definition(tmp_path, xtce(layout)), encode_packets(layout, frames))
    # 1958 is 12 years and 3 leap days before 1970.
    coarse = np.array([packet["time_coarse"] for packet in theirs]) - (12 * 365 + 3) * 86_400
    fine = np.array([packet["time_fine"] for packet in theirs])
    assert coarse + fine / 65_536 == pytest.approx(frames.t_tai_ns / 1e9, abs=1e-5)
    assert all(packet["PKT_APID"] == 322 for packet in theirs)


def test_physical_values_of_every_width():
    layout = small_layout(ODD)
    fields = {field.name: field for field in layout.scalars}
    raw = np.array([0, 1, 2**12 - 1, 2**12, 2**13 - 1], np.uint64)
    assert physical(fields["signed"], raw).tolist() == [0, 1, 4095, -4096, -1]


def test_what_a_form_cannot_say():
    with pytest.raises(InputError, match="35937 combinations"):
        xtce(load_layout(EXAMPLE), "expanded")
    odd = small_layout(ODD.replace("i33", "i35"))
    with pytest.raises(InputError, match="b has 91 bits"):
        xtce(odd, "binary")
