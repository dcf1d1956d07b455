"""Framing: every undamaged packet is found, and every byte is a packet's or a record's."""

from __future__ import annotations

import struct
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from packet_cases import crc16, decode, frame_numbers, packet, small_layout, star_packet, stars_of

from stcal.telemetry import packet_kernels as kernels
from stcal.telemetry.cosmos import log_of

LAYOUT = small_layout()
STRICT = small_layout(ignored="[]")
WITHOUT_CRC = small_layout(crc='"none"')


def stream_of(numbers, **options) -> list[bytes]:
    return [star_packet(n, stars_of(n), **options) for n in numbers]


def found_in(content, layout=LAYOUT, **options):
    _, blocks, records = decode(layout, content, **options)
    return frame_numbers(blocks), Counter(record.code for record in records), records


def test_crc_of_the_standard_and_of_any_length():
    """The check value of CRC-16/IBM-3740 (alias CCITT-FALSE) is 0x29B1."""
    content = np.frombuffer(b"123456789", np.uint8)
    assert kernels.crc16(content, 0, 9) == 0x29B1
    random = np.random.default_rng(0).integers(0, 256, 300).astype(np.uint8)
    for stop in range(40, 60):
        assert kernels.crc16(random, 3, stop) == crc16(random[3:stop].tobytes())


def test_packets_back_to_back():
    numbers, codes, _ = found_in(b"".join(stream_of(range(40))))
    assert numbers == list(range(40))
    assert not codes


@pytest.mark.parametrize("block_bytes", [1, 7, 64, 1000])
@pytest.mark.parametrize("is_log", [False, True])
def test_the_size_of_blocks_leaves_no_trace(block_bytes, is_log):
    packets = stream_of(range(60))
    packets[5] = b"\x55" + packets[5][1:]
    packets[30] = packets[30][:9] + b"\xff" + packets[30][10:]
    content = (
        log_of([(n, p) for n, p in enumerate(packets)], "SAT", "STARS")
        if is_log
        else b"".join(packets)
    )
    whole = decode(LAYOUT, content, is_log)
    pieces = decode(LAYOUT, content, is_log, block_bytes)
    assert frame_numbers(whole[1]) == frame_numbers(pieces[1])
    assert len(frame_numbers(whole[1])) == 58
    assert whole[2] == pieces[2]
    assert whole[0].report() == pieces[0].report()


def test_a_bad_crc_costs_that_packet_and_says_so():
    packets = stream_of(range(5))
    packets[2] = packets[2][:20] + bytes([packets[2][20] ^ 4]) + packets[2][21:]
    numbers, codes, (record,) = found_in(b"".join(packets))
    assert numbers == [0, 1, 3, 4]
    assert codes == {"packet_crc": 1}
    assert record.raw == packets[2]
    assert record.offset == len(packets[0] + packets[1])
    assert record.row == 3
    assert "the CRC is" in record.detail


def test_lost_and_foreign_bytes():
    packets = stream_of(range(6))
    content = (
        b"junk" + packets[0] + packets[1][:15] + packets[2] + b"\0" * 70 + packets[3] + packets[4]
    )
    content += packets[5][:-4]
    numbers, codes, records = found_in(content)
    assert numbers == [0, 2, 3, 4]
    assert codes == {"packet_sync": 3, "truncated": 1}
    assert [record.raw for record in records] == [
        b"junk",
        packets[1][:15],
        b"\0" * 70,
        packets[5][:-4],
    ]


def test_a_length_that_leads_onto_a_later_packet_hides_none():
    """The damaged length spans exactly three packets."""
    packets = [star_packet(n, stars_of(2)) for n in range(6)]
    size = len(packets[0])
    packets[1] = packets[1][:4] + struct.pack(">H", 3 * size - 7) + packets[1][6:]
    layout = small_layout('  { name = "spare", type = "u8" },', count='count = "n"')
    assert found_in(b"".join(packets))[0] == [0, 2, 3, 4, 5]
    assert layout.largest > LAYOUT.largest


def test_lengths_that_the_layout_cannot_have():
    long = packet(bytes(300))
    wrong_count = star_packet(3, stars_of(3))
    wrong_count = packet(wrong_count[6:-2][:12] + b"\x02" + wrong_count[19:-2], sequence=3)
    too_many = star_packet(4, [(1, 1, 0)] * 5)[6:-2]
    too_many = packet(too_many[:12] + b"\x06" + too_many[13:], sequence=4)
    packets = [*stream_of(range(2)), long, wrong_count, too_many, *stream_of([5])]
    numbers, codes, records = found_in(b"".join(packets))
    assert numbers == [0, 1, 5]
    assert codes == {"packet_length": 3}
    assert "n is 6, stars has at most 5" in records[2].detail
    assert records[2].sensor_id == "ST16-1"


def test_segments_are_refused():
    packets = [*stream_of([0]), star_packet(1, stars_of(1), flags=1), *stream_of([2])]
    numbers, codes, _ = found_in(b"".join(packets))
    assert numbers == [0, 2]
    assert codes == {"packet_segmented": 1}


def test_other_apids_are_stepped_over():
    other = packet(bytes(50), apid=99, crc=False)
    idle = packet(bytes(9), apid=2047, crc=False)
    content = b"".join([other, *stream_of([0]), idle, other, *stream_of([1, 2]), other])
    decoder, blocks, records = decode(LAYOUT, content)
    assert frame_numbers(blocks) == [0, 1, 2]
    assert not records
    assert decoder.report()["other_packets"] == 4
    assert found_in(content, STRICT)[1]["packet_sync"] == 3


def test_a_header_of_another_apid_that_leads_nowhere_hides_nothing():
    fake = packet(bytes(40), apid=99, crc=False)[:12]
    packets = stream_of(range(4))
    numbers, codes, (record,) = found_in(packets[0] + fake + b"".join(packets[1:]))
    assert numbers == [0, 1, 2, 3]
    assert codes == {"packet_sync": 1}
    assert record.raw == fake


def test_without_crc_the_lists_are_the_check():
    packets = stream_of(range(5), crc=False)
    packets[2] = packets[2][:18] + b"\x03" + packets[2][19:]
    numbers, codes, _ = found_in(b"".join(packets), WITHOUT_CRC)
    assert numbers == [0, 1, 3, 4]
    assert codes == {"packet_length": 1}


def test_counts_by_apid():
    sent = [16_380, 16_381, 16_381, 16_383, 0, 1, 5, 4, 4]
    packets = [star_packet(n, stars_of(n), sequence=s) for n, s in enumerate(sent)]
    packets[2], packets[8] = packets[1], packets[7]
    packets += [star_packet(50 + n, [], sequence=n, apid=322) for n in (0, 3, 3)]
    packets[-1] = star_packet(99, [], sequence=3, apid=322)
    decoder, _, _ = decode(LAYOUT, b"".join(packets))
    first, second = decoder.report()["apids"]
    assert first == {
        "apid": 321,
        "sensor_id": "ST16-1",
        "packets": 9,
        "duplicates": 2,
        "gaps": 2,
        "lost": 3,  # 16382, 2, 3
        "reused_numbers": 0,
    }
    assert (second["packets"], second["lost"], second["reused_numbers"]) == (3, 2, 1)


def test_a_dump_that_overlaps_the_one_before_loses_nothing():
    packets = stream_of(range(100))
    decoder, blocks, _ = decode(LAYOUT, b"".join(packets[:70] + packets[40:]))
    assert len(frame_numbers(blocks)) == 130
    (counts,) = decoder.report()["apids"]
    assert (counts["packets"], counts["duplicates"], counts["lost"]) == (130, 30, 0)


class TestLogs:
    def entries(self, packets, **options):
        return log_of(
            [(10**18 + n, one) for n, one in enumerate(packets)], "SAT", "STARS", **options
        )

    def test_the_form_of_openc3(self):
        """As OpenC3's packet_log_writer.rb packs it: 'NnnQ>', then 'Q>' and 'N' where flagged."""
        data = star_packet(7, stars_of(7))
        content = b"COSMOS5_"
        content += struct.pack(">IH", 2 + 3 + 32, 0x1200) + b"SAT" + bytes(32)
        content += struct.pack(">IHH", 4 + 5 + 32, 0x2200, 0) + b"STARS" + bytes(32)
        content += struct.pack(">IHHQ", 12 + len(data), 0x3400, 0, 10**18) + data
        extra = b'{"a":1}'
        size = 12 + 8 + 4 + len(extra) + len(data)
        content += (
            struct.pack(">IHHQQI", size, 0x30C0, 0, 10**18, 10**18, len(extra)) + extra + data
        )
        content += struct.pack(">IHHQ", 12 + len(data), 0x3800, 0, 10**18) + data  # a command
        content += struct.pack(">IHHQ", 12 + 2, 0x4000, 0, 10**18) + b"{}"
        content += struct.pack(">IH", 2 + 5, 0x5000) + b"0-0,x"
        numbers, codes, _ = found_in(content, is_log=True)
        assert numbers == [7, 7]
        assert not codes

    @pytest.mark.parametrize("received_ns", [None, 5])
    def test_whole_logs_one_after_the_other(self, received_ns):
        one = self.entries(stream_of(range(20)), received_ns=received_ns)
        numbers, codes, _ = found_in(one + one, is_log=True)
        assert numbers == 2 * list(range(20))
        assert not codes

    def test_damage_to_a_packet_and_to_an_entry(self):
        packets = stream_of(range(8))
        content = self.entries(packets)
        bad = bytearray(content)
        bad[content.index(packets[2]) + 20] ^= 1
        bad[content.index(packets[5]) - 16] = 0xFF  # the entry's length
        numbers, codes, records = found_in(bytes(bad), is_log=True)
        assert numbers == list(range(2)) + list(range(3, 8))
        assert codes == {"packet_crc": 1, "packet_sync": 1}
        assert records[0].raw == bytes(bad[content.index(packets[2]) :][: len(packets[2])])

    def test_a_log_that_is_cut(self):
        content = self.entries(stream_of(range(3)))
        numbers, codes, _ = found_in(content[: content.rindex(b"\0\0\0") - 20], is_log=True)
        assert numbers == [0, 1]
        assert sum(codes.values()) == 1


FIRST = 1
damage = st.lists(
    st.tuples(
        st.integers(0, 11),
        st.sampled_from(["flip", "cut", "drop", "insert", "repeat"]),
        st.integers(0, 60),
        st.binary(min_size=1, max_size=40),
    ),
    max_size=6,
)


def damaged(packets: list[bytes], changes) -> tuple[list[bytes], set[int]]:
    """Return the stream's pieces, and the packets that are still whole."""
    pieces, whole = list(packets), set(range(len(packets)))
    for which, how, place, junk in changes:
        one = pieces[which]
        place = min(place, max(len(one) - 1, 0))
        if how == "flip" and one:
            pieces[which] = one[:place] + bytes([one[place] ^ (junk[0] | 1)]) + one[place + 1 :]
            whole.discard(which)
        elif how == "cut":
            pieces[which] = one[:place]
            whole.discard(which)
        elif how == "drop" and one:
            pieces[which] = one[:place] + one[place + 1 :]
            whole.discard(which)
        elif how == "insert":
            pieces[which] = junk + one
        elif how == "repeat":
            pieces[which] = one + one
    return pieces, whole


@settings(max_examples=300, deadline=None)
@given(damage, st.booleans(), st.sampled_from([16, 100, 1 << 20]))
def test_mutated_streams_give_every_undamaged_packet(changes, is_log, block_bytes):
    packets = stream_of(range(FIRST, FIRST + 12))
    # Else a packet whose last byte is cut would be whole again with the first byte of the next.
    assert all(one[-1] != one[0] for one in packets)
    pieces, whole = damaged(packets, changes)
    content = b"".join(pieces)
    if is_log:
        content = log_of([(n, piece) for n, piece in enumerate(pieces)], "SAT", "STARS")
    _, blocks, records = decode(STRICT, content, is_log, block_bytes)
    assert {FIRST + n for n in whole} <= set(frame_numbers(blocks))
    for record in records:
        assert content[record.offset :][: len(record.raw)] == record.raw
    for block in blocks:
        for i, offset in enumerate(block.offset.tolist()):
            assert content[offset:].startswith(block.raw(i))
    if not is_log:
        covered = sum(len(record.raw) for record in records)
        first = [np.flatnonzero(np.diff(b.run, prepend=-1)) for b in blocks if len(b)]
        used = [b for b in blocks if len(b)]
        covered += sum(len(b.raw(i)) for b, at in zip(used, first, strict=True) for i in at)
        assert covered == len(content)


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=400), st.booleans())
def test_any_bytes_at_all(content, is_log):
    for layout in (LAYOUT, WITHOUT_CRC):
        head = b"COSMOS5_" if is_log else b""
        _, _, records = decode(layout, head + content + star_packet(1, []), is_log)
        assert all(record.raw for record in records)


@pytest.mark.parametrize("is_log", [False, True])
def test_long_damage_comes_in_parts(is_log):
    first, last = star_packet(1, stars_of(1)), star_packet(2, stars_of(2))
    hole = bytes(3 << 20)
    content = first + hole + last
    if is_log:
        content = log_of([(0, first)], "SAT", "STARS") + b"\xff" + hole + last
    numbers, codes, records = found_in(content, is_log=is_log, block_bytes=1 << 18)
    assert numbers == [1, 2]
    assert set(codes) == {"packet_sync"}
    assert len(records) >= 2
    assert max(len(record.raw) for record in records) < 2 << 20
    place = content.index(hole)
    assert sum(len(record.raw) for record in records) == len(hole) + is_log
    for record in records:
        assert record.offset >= place - is_log
        assert content[record.offset :][: len(record.raw)] == record.raw
