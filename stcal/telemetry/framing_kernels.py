"""Compiled framing: where the packets of a stream or of a log are, and what is none.

Where a packet is in order, the next begins behind it; where none is, every byte is tried until a
whole packet with a good check begins.  What lies between is damage, and is told by its range.
"""

from __future__ import annotations

import numpy as np

from stcal.jit import kernel
from stcal.telemetry.packet_kernels import FITS, IGNORED, NOT_OURS, OURS, crc16, find_segments

# Beside a length: no packet begins here; it does, or may, but its end is not here yet.
_NONE, _MORE = 0, -1
_PRIMARY = 6
_MAGIC = np.frombuffer(b"COSMOS5_", np.uint8).astype(np.int64)
_RAW_ENTRY, _LAST_ENTRY_TYPE = 3, 6
_COMMAND, _RECEIVED_TIME, _EXTRA = 0x0800, 0x0040, 0x0080
_LARGEST_ENTRY = 16 << 20
_SKIPPED, _PACKET, _FOREIGN, _DAMAGED, _LOST = 1, 2, 3, 4, 5


@kernel
def _length_at(data, p, stop, program):
    """Bytes of the packet that a header at ``p`` announces: a possible one, ours or ignored."""
    if p + _PRIMARY > stop:
        return _MORE
    first = np.int64(data[p])
    # Version 0, telemetry.
    if first >> 4:
        return _NONE
    kind = program.kind[(first & 7) << 8 | np.int64(data[p + 1])]
    if kind == NOT_OURS:
        return _NONE
    total = (np.int64(data[p + 4]) << 8 | np.int64(data[p + 5])) + _PRIMARY + 1
    if kind == IGNORED:
        return total
    if not first & 8 or total < program.smallest or total > program.largest:
        return _NONE
    return total


@kernel
def is_ours(data, p, program):
    """Whether the header at ``p``, which is whole, has an APID of ours."""
    apid = (np.int64(data[p]) & 7) << 8 | np.int64(data[p + 1])
    return program.kind[apid] == OURS


@kernel
def _skip(data, p, stop, kind):
    """The next byte from ``p`` on that may begin a packet of ours, or whose header is not whole.

    Damage is gone through by this loop: a call that is handed the whole program costs a third of a
    microsecond.
    """
    while p + _PRIMARY <= stop:
        first = np.int64(data[p])
        if first >> 4 == 0 and kind[(first & 7) << 8 | np.int64(data[p + 1])] == OURS:
            break
        p += 1
    return p


@kernel
def _whole_at(data, p, stop, program, segment, count):
    """Bytes of a good packet of ours at ``p``: by its CRC, else by what its lists add up to."""
    total = _length_at(data, p, stop, program)
    if total <= 0:
        return total
    if not is_ours(data, p, program):
        return _NONE
    if p + total > stop:
        return _MORE
    if program.crc_bytes:
        return total if crc16(data, p, p + total) == 0 else _NONE
    fits = find_segments(data, p, total, program, segment, count) == FITS
    return total if fits else _NONE


@kernel
def _ignored_at(data, p, stop, final, program):
    """Bytes of an ignored packet at ``p``: what follows it must be a possible packet too."""
    total = _length_at(data, p, stop, program)
    if total <= 0 or is_ours(data, p, program):
        return min(total, _NONE)
    if p + total > stop:
        return _MORE
    follows = _length_at(data, p + total, stop, program)
    if follows == _MORE:
        return total if final else _MORE
    return total if follows > 0 else _NONE


@kernel
def frame_stream(data, final, synced, program, starts, totals, damage):
    """Find the packets of a stream of packets back to back.

    Parameters
    ----------
    data : (n,) uint8; ``final`` says whether the stream ends with it
    synced : whether a packet should begin at 0
    starts, totals : (k,) filled with the packets of ours
    damage : (k + 1, 2) filled with the ranges that are no packets

    Returns
    -------
    packets, damaged ranges, ignored packets : how many
    used : the bytes that are done with
    reached : the bytes looked at; beyond ``used`` they are damage whose end is not known yet
    """
    segment = np.zeros(len(program.segment_bits), np.int64)
    count = np.zeros(len(program.stride), np.int64)
    stop = len(data)
    packets, ranges, ignored = 0, 0, 0
    p, bad = 0, -1 if synced else 0
    while p < stop:
        if bad >= 0:
            p = _skip(data, p, stop, program.kind)
        step = _whole_at(data, p, stop, program, segment, count)
        if step > 0:
            starts[packets], totals[packets] = p, step
            packets += 1
        elif step == _NONE and bad < 0:
            step = _ignored_at(data, p, stop, final, program)
            ignored += step > 0
        if step == _MORE and not final:
            break
        if step > 0:
            ranges = _close(damage, ranges, bad, p)
            bad, p = -1, p + step
        else:
            bad = p if bad < 0 else bad
            p += 1
    if final:
        ranges, bad = _close(damage, ranges, bad, stop), -1
    return packets, ranges, ignored, (bad if bad >= 0 else p), p


@kernel
def _close(damage, ranges, bad, stop):
    """Note the range from ``bad`` on, if there is one; return how many there are."""
    if 0 <= bad < stop:
        damage[ranges] = (bad, stop)
        return ranges + 1
    return ranges


@kernel
def _next_whole(data, p, stop, final, program, segment, count):
    """Where the next good packet of ours begins, from ``p`` on; its bytes, or why there is none."""
    while p < stop:
        p = _skip(data, p, stop, program.kind)
        total = _whole_at(data, p, stop, program, segment, count)
        if total > 0 or (total == _MORE and not final):
            return p, total
        p += 1
    return stop, _NONE


@kernel
def _u32(data, p):
    return (
        np.int64(data[p]) << 24
        | np.int64(data[p + 1]) << 16
        | np.int64(data[p + 2]) << 8
        | np.int64(data[p + 3])
    )


@kernel
def _is_magic(data, p, stop):
    if p + len(_MAGIC) > stop:
        return False
    same = 0
    for i in range(len(_MAGIC)):
        same += np.int64(data[p + i]) == _MAGIC[i]
    return same == len(_MAGIC)


@kernel
def _entry_end(data, p, stop):
    """Where a log entry at ``p`` ends; NONE if none can be there, MORE if it goes beyond."""
    if p + 6 > stop:
        return _MORE
    length = _u32(data, p)
    kind = np.int64(data[p + 4]) >> 4
    if length < 2 or length > _LARGEST_ENTRY or kind < 1 or kind > _LAST_ENTRY_TYPE:
        return _NONE
    return p + 4 + length if p + 4 + length <= stop else _MORE


@kernel
def _entry_data(data, p, end):
    """Where the telemetry packet of a log entry begins; NONE where it has none."""
    flags = np.int64(data[p + 4]) << 8 | np.int64(data[p + 5])
    if flags >> 12 != _RAW_ENTRY or flags & _COMMAND:
        return _NONE
    q = p + 16 + (8 if flags & _RECEIVED_TIME else 0)
    if flags & _EXTRA:
        q += 4 + (_u32(data, q) if q + 4 <= end else 0)
    return q if q + _PRIMARY <= end else _NONE


@kernel
def _read_entry(data, p, stop, final, program, segment, count):
    """Read the log entry at ``p``: what it is, where its packet begins, where the next one is.

    LOST: the packet is damaged and so, perhaps, is the entry's length.
    """
    if _is_magic(data, p, stop):
        return _SKIPPED, p, p + len(_MAGIC)
    end = _entry_end(data, p, stop)
    if end == _MORE and not final:
        return _MORE, p, p
    if end <= 0:
        return _LOST, p, p
    q = _entry_data(data, p, end)
    if q == _NONE:
        return _SKIPPED, p, end
    total = _whole_at(data, q, end, program, segment, count)
    if total > 0:
        return _PACKET, q, q + total
    announced = (np.int64(data[q + 4]) << 8 | np.int64(data[q + 5])) + _PRIMARY + 1
    if not is_ours(data, q, program) and q + announced == end:
        return _FOREIGN, q, end
    found, _ = _next_whole(data, q + 1, end, True, program, segment, count)
    # The end is believed when no packet begins before it and an entry behind it.
    if found == end and (end == stop or _entry_end(data, end, stop) != _NONE):
        return _DAMAGED, q, end
    return _LOST, q, q


@kernel
def frame_log(data, final, synced, program, starts, totals, damage):
    """Find the packets of an OpenC3 COSMOS 5 log, as :func:`frame_stream` does in a stream.

    An entry is a length, flags and, if it is a raw packet, a packet index, a time, perhaps a
    second time and perhaps further data, before the packet.  Where the log is damaged, the next
    packet is found by itself, and what follows it is the next entry.
    """
    segment = np.zeros(len(program.segment_bits), np.int64)
    count = np.zeros(len(program.stride), np.int64)
    stop = len(data)
    packets, ranges, ignored = 0, 0, 0
    p, bad = 0, -1 if synced else 0
    while p < stop:
        total = _NONE
        if bad < 0:
            what, begin, p = _read_entry(data, p, stop, final, program, segment, count)
            if what == _MORE:
                break
            ignored += what == _FOREIGN
            if what == _DAMAGED:
                ranges = _close(damage, ranges, begin, p)
            elif what == _PACKET:
                total = p - begin
            elif what == _LOST:
                bad = p
        else:
            begin, total = _next_whole(data, p, stop, final, program, segment, count)
            if total == _MORE:
                p = begin
                break
            ranges = _close(damage, ranges, bad, begin)
            bad, p = -1, begin + total
        if total > 0:
            starts[packets], totals[packets] = begin, total
            packets += 1
    if final:
        ranges, bad = _close(damage, ranges, bad, stop), -1
    return packets, ranges, ignored, (bad if bad >= 0 else p), p
