"""Streams of packets in blocks: the packets of a layout, and what lies between them.

A block is at least ``BLOCK_BYTES`` of the file, and its last packet is never cut: what is not whole
yet comes with the next block.  Damage whose end does not come within ``_MAXIMUM_DAMAGE`` is given
in parts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.frames import Ints
from stcal.telemetry import framing_kernels
from stcal.telemetry import packet_kernels as kernels
from stcal.telemetry.packet_layout import PRIMARY_HEADER_BYTES, PacketLayout
from stcal.telemetry.quarantine import TRUNCATED

Bytes = NDArray[np.uint8]

BLOCK_BYTES = 8 << 20
_MAXIMUM_DAMAGE = 1 << 20
# No packet is shorter: one byte of data.
_SHORTEST = PRIMARY_HEADER_BYTES + 1

SYNC, CRC, LENGTH = "packet_sync", "packet_crc", "packet_length"


@dataclass(frozen=True)
class Damage:
    """Bytes that are no packet: where they begin in the block, what they are, and why."""

    start: int
    raw: bytes
    code: str
    detail: str


@dataclass(frozen=True)
class PacketBlock:
    """Packets of a layout in a piece of a stream.

    Attributes
    ----------
    data : bytes of the piece
    offset : where it begins in the decompressed file
    start, total : (n,) first byte of each packet in ``data``, and its bytes
    damage : what is no packet, in order
    ignored : packets of other APIDs
    """

    data: Bytes
    offset: int
    start: Ints
    total: Ints
    damage: list[Damage]
    ignored: int

    @property
    def is_junk(self) -> bool:
        """Whether nothing in it is a packet, not even a damaged or a foreign one."""
        others = self.ignored or any(piece.code != SYNC for piece in self.damage)
        return len(self.data) > 0 and not len(self.start) and not others


def frame_blocks(
    layout: PacketLayout,
    program: kernels.Program,
    parts: Iterator[bytes],
    is_log: bool,
    block_bytes: int = BLOCK_BYTES,
) -> Iterator[PacketBlock]:
    """Yield the packets of a stream: back to back, or the entries of a COSMOS log."""
    frame = framing_kernels.frame_log if is_log else framing_kernels.frame_stream
    kept, offset, synced, final = b"", 0, True, False
    while not final:
        fresh, final = _gather(parts, block_bytes)
        content = kept + fresh
        data = np.frombuffer(content, np.uint8)
        most = len(data) // _SHORTEST + 1
        start, total = np.empty(most, np.int64), np.empty(most, np.int64)
        ranges = np.empty((most + 1, 2), np.int64)
        packets, damaged, ignored, used, reached = frame(
            data, final, synced, program, start, total, ranges
        )
        found = ranges[:damaged].tolist()
        synced = reached - used <= _MAXIMUM_DAMAGE
        if not synced:
            found.append([used, reached])
            used = reached
        damage = [
            piece for a, b in found for piece in _explain(layout, program, content, a, b, final)
        ]
        yield PacketBlock(
            data, offset, start[:packets].copy(), total[:packets].copy(), damage, ignored
        )
        kept, offset = content[used:], offset + used


def _gather(parts: Iterator[bytes], wanted: int) -> tuple[bytes, bool]:
    """Return at least so many bytes, and whether the stream has ended."""
    taken, size = [], 0
    for part in parts:
        taken.append(part)
        size += len(part)
        if size >= wanted:
            return b"".join(taken), False
    return b"".join(taken), True


def _explain(
    layout: PacketLayout,
    program: kernels.Program,
    content: bytes,
    start: int,
    stop: int,
    final: bool,
) -> Iterator[Damage]:
    """Yield the parts of a damaged range: packets with a bad check, and what is none at all."""
    place = start
    while place < stop:
        total = _announced(program, content, place, stop)
        if program.smallest <= total <= min(program.largest, stop - place):
            yield _bad_packet(layout, content[place : place + total], place)
            place += total
            continue
        end = _next_chain(layout, program, content, place + 1, stop)
        at_end = final and end == len(content)
        yield _no_packet(program, content[place:end], place, total, at_end)
        place = end


def _announced(program: kernels.Program, content: bytes, place: int, stop: int) -> int:
    """Return the bytes of the packet that a header of ours announces; 0 where there is none."""
    if place + PRIMARY_HEADER_BYTES > stop or content[place] >> 3 != 1:
        return 0
    if program.kind[(content[place] & 7) << 8 | content[place + 1]] != kernels.OURS:
        return 0
    return int.from_bytes(content[place + 4 : place + 6], "big") + _SHORTEST


def _next_chain(
    layout: PacketLayout, program: kernels.Program, content: bytes, start: int, stop: int
) -> int:
    """Return where headers begin that lead packet by packet to the range's end; else that end."""
    dead: set[int] = set()
    places = {
        place
        for apid in layout.apids.values()
        for place in _occurrences(content, (0x0800 | apid).to_bytes(2, "big"), start, stop)
    }
    for first in sorted(places):
        place, walked = first, []
        while place < stop and place not in dead:
            walked.append(place)
            total = _announced(program, content, place, stop)
            if not program.smallest <= total <= program.largest:
                break
            place += total
        if place == stop:
            return first
        dead.update(walked)
    return stop


def _occurrences(content: bytes, wanted: bytes, start: int, stop: int) -> Iterator[int]:
    place = content.find(wanted, start, stop)
    while place >= 0:
        yield place
        place = content.find(wanted, place + 1, stop)


def _no_packet(
    program: kernels.Program, raw: bytes, place: int, total: int, at_end: bool
) -> Damage:
    if not total:
        return Damage(place, raw, SYNC, f"{len(raw)} bytes that begin no packet")
    if not program.smallest <= total <= program.largest:
        limits = f"the layout has {program.smallest} to {program.largest}"
        return Damage(place, raw, LENGTH, f"the header says {total} bytes, {limits}")
    if at_end:
        return Damage(place, raw, TRUNCATED, f"the file ends after {len(raw)} of {total} bytes")
    return Damage(place, raw, SYNC, f"{len(raw)} of the {total} bytes that the header says")


def _bad_packet(layout: PacketLayout, raw: bytes, place: int) -> Damage:
    if not layout.has_crc:
        return Damage(place, raw, LENGTH, f"the lists do not fit the packet's {len(raw)} bytes")
    said = int.from_bytes(raw[-2:], "big")
    found = int(kernels.crc16(np.frombuffer(raw, np.uint8), 0, len(raw) - 2))
    return Damage(place, raw, CRC, f"the CRC is {said:04x}, that of the bytes {found:04x}")


class SequenceCounts:
    """Sequence counts by APID, unwrapped: each step is the nearest one modulo 2^14.

    Packets that come again, out of order or late count once; what never came is lost.  Sixteen
    bytes are kept for every packet.
    """

    def __init__(self, names: dict[int, str]) -> None:
        """Take the sensor's name of each APID."""
        self._names = names
        self._count: dict[int, list[Ints]] = {}
        self._digest: dict[int, list[NDArray[np.uint64]]] = {}
        self.ignored = 0

    def add(self, apid: Ints, sequence: Ints, digest: NDArray[np.uint64]) -> None:
        """Take the packets of a block, in their order."""
        for one in np.unique(apid).tolist():
            mine = apid == one
            self._count.setdefault(one, []).append(sequence[mine])
            self._digest.setdefault(one, []).append(digest[mine])

    def document(self) -> dict[str, Any]:
        """Return the counts by APID."""
        apids = [self._one(apid) for apid in sorted(self._count)]
        return {"apids": apids, "other_packets": self.ignored}

    def _one(self, apid: int) -> dict[str, Any]:
        unwrapped = _unwrap(np.concatenate(self._count[apid]))
        digest = np.concatenate(self._digest[apid])
        copies = np.rec.fromarrays([unwrapped, digest])
        distinct, numbers = len(np.unique(copies)), np.unique(unwrapped)
        steps = np.diff(numbers)
        return {
            "apid": apid,
            "sensor_id": self._names[apid],
            "packets": len(unwrapped),
            "duplicates": len(unwrapped) - distinct,
            "gaps": int(np.count_nonzero(steps > 1)),
            "lost": int((steps - 1).sum()),
            # Different packets under one number: the counter began anew.
            "reused_numbers": distinct - len(numbers),
        }


def _unwrap(sequence: Ints) -> Ints:
    step = (np.diff(sequence) + 8192) % 16384 - 8192
    return np.concatenate((sequence[:1], sequence[0] + np.cumsum(step)))
