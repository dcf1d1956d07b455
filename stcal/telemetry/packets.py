"""Decode packet telemetry: CCSDS space packets back to back, or an OpenC3 COSMOS log of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa

from stcal.errors import InputError
from stcal.frames import Ints
from stcal.telemetry import cosmos
from stcal.telemetry import packet_kernels as kernels
from stcal.telemetry.block import Again, Decoder, RowBlock
from stcal.telemetry.columns import COLUMNS
from stcal.telemetry.packet_decode import (
    UNSEGMENTED,
    DecodedPackets,
    Places,
    decode_packets,
    find_places,
    headers_of,
    make_program,
)
from stcal.telemetry.packet_fields import FRAME_FIELDS, STAR_FIELDS
from stcal.telemetry.packet_layout import PacketLayout, parse_layout
from stcal.telemetry.packet_stream import (
    BLOCK_BYTES,
    LENGTH,
    PacketBlock,
    SequenceCounts,
    frame_blocks,
)
from stcal.telemetry.quarantine import Rejection
from stcal.telemetry.sources import SourceFile, stream
from stcal.telemetry.typed import Typed

SEGMENTED, MATCH_INDEX = "packet_segmented", "match_index"


class PacketDecoder:
    """Decodes the packets of one file; afterwards ``report`` has the counts by APID."""

    def __init__(
        self,
        layout: PacketLayout,
        is_log: bool,
        block_bytes: int = BLOCK_BYTES,
        may_be_junk: bool = False,
    ) -> None:
        """Take the layout, whether the file is a COSMOS log, and whether it may hold no packet."""
        self._may_be_junk = may_be_junk
        self._layout, self._is_log, self._block_bytes = layout, is_log, block_bytes
        self._program = make_program(layout)
        names = {apid: sensor for sensor, apid in layout.apids.items()}
        self._sensor_ids = pa.array([names.get(apid) for apid in range(2048)], pa.string())
        self._counts = SequenceCounts(names)
        self._row = 1

    def decode(self, source: SourceFile, warn: Callable[[str], None]) -> Iterator[RowBlock]:
        """Yield the rows of the file's packets; every packet is a row number.

        Raises
        ------
        InputError
            Naming the file: it does not begin with packets, nor with damaged ones.
        """
        return self.decode_parts(stream(source), str(source.path), warn)

    def decode_parts(
        self, parts: Iterator[bytes], where: str, warn: Callable[[str], None]
    ) -> Iterator[RowBlock]:
        """As :meth:`decode`, from the parts of a stream."""
        blocks = frame_blocks(self._layout, self._program, parts, self._is_log, self._block_bytes)
        for number, block in enumerate(blocks):
            if number == 0 and not self._may_be_junk and block.is_junk:
                raise InputError(
                    f"{where}: no packet of the layout {self._layout.name!r} in its first "
                    f"{len(block.data)} bytes"
                )
            yield self._rows(block)
        document = self._counts.document()
        for one in document["apids"]:
            if one["lost"]:
                warn(
                    f"APID {one['apid']}: packets lost by the sequence count: {one['lost']}, "
                    f"gaps: {one['gaps']}"
                )
        if not document["apids"]:
            warn("no packet of the layout's APIDs")

    def report(self) -> dict[str, Any]:
        """Return packets, duplicates, gaps and lost packets by APID."""
        return self._counts.document()

    def _rows(self, block: PacketBlock) -> RowBlock:
        header = headers_of(block.data, block.start)
        digest = np.empty(len(block.start), np.uint64)
        kernels.digest(block.data, block.start, block.total, digest)
        self._counts.add(header.apid, header.sequence, digest)
        self._counts.ignored += block.ignored
        places = find_places(self._program, block.data, block.start, block.total)
        row, damage_row = self._number(block)
        rejected = [
            Rejection(number, piece.code, piece.detail, piece.raw, block.offset + piece.start)
            for number, piece in zip(damage_row, block.damage, strict=True)
        ]
        good = (places.fits == kernels.FITS) & (header.flags == UNSEGMENTED)
        decoded = decode_packets(self._layout, block.data, places.take(good))
        if decoded.match_problem.any():
            good[np.flatnonzero(good)[decoded.match_problem]] = False
            decoded = decode_packets(self._layout, block.data, places.take(good))
        for i in np.flatnonzero(~good).tolist():
            code, detail = self._reason(int(header.flags[i]), places, i)
            rejected.append(self._rejection(block, row, int(header.apid[i]), i, code, detail))
        return self._expand(block, decoded, row, header.apid, np.flatnonzero(good), rejected)

    def _number(self, block: PacketBlock) -> tuple[Ints, list[int]]:
        """Number packets and damage in the order of the file."""
        damage = np.array([piece.start for piece in block.damage], np.int64)
        begins = np.concatenate((block.start, damage))
        rank = np.empty(len(begins), np.int64)
        rank[np.argsort(begins, kind="stable")] = np.arange(len(begins))
        number = self._row + rank
        self._row += len(begins)
        return number[: len(block.start)], number[len(block.start) :].tolist()

    def _reason(self, flags: int, places: Places, i: int) -> tuple[str, str]:
        if flags != UNSEGMENTED:
            return SEGMENTED, f"sequence flags {flags:02b}: a segment, not a whole packet"
        if places.fits[i] == kernels.TOO_MANY:
            for k, one in enumerate(self._layout.lists):
                if places.count[i, k] > one.maximum:
                    what = f"{one.count} is {places.count[i, k]}, {one.name} has at most"
                    return LENGTH, f"{what} {one.maximum}"
        if places.fits[i] != kernels.FITS:
            return LENGTH, "the lists do not add up to the packet's length"
        return MATCH_INDEX, "a match points beyond the list of stars, or two at one star"

    def _rejection(
        self, block: PacketBlock, row: Ints, apid: int, i: int, code: str, detail: str
    ) -> Rejection:
        raw = block.data[block.start[i] : block.start[i] + block.total[i]].tobytes()
        offset = block.offset + int(block.start[i])
        sensor = self._sensor_ids[apid].as_py()
        return Rejection(int(row[i]), code, detail, raw, offset, sensor_id=sensor)

    def _expand(
        self,
        block: PacketBlock,
        decoded: DecodedPackets,
        row: Ints,
        apid: Ints,
        which: Ints,
        rejected: list[Rejection],
    ) -> RowBlock:
        """Return a row a star, or one for a packet without stars; ``which`` were decoded."""
        shape = _RowShape(self._layout, decoded)
        packet = which[shape.packet]
        columns: dict[str, Any] = {
            column.name: pa.nulls(len(which), pa.string()) for column in COLUMNS
        }
        columns["sensor_id"] = self._sensor_ids.take(pa.array(apid[which]))
        columns["time_utc"] = decoded.t_tai_ns
        columns |= {
            name: column for name, column in decoded.scalars.items() if name in FRAME_FIELDS
        }
        columns |= shape.stars(decoded)
        start, total = block.start[packet], block.total[packet]
        return RowBlock(
            columns=columns,
            row=row[packet],
            run=shape.packet,
            raw=lambda i: block.data[start[i] : start[i] + total[i]].tobytes(),
            offset=block.offset + start,
            rejected=sorted(rejected, key=lambda record: record.row),
            lines_are_frames=True,
            frames_span_lines=self._layout.frames_span_packets,
            frame=shape.packet,
        )


class _RowShape:
    """How packets become rows: a row a star of every list, or one row where there is none."""

    def __init__(self, layout: PacketLayout, decoded: DecodedPackets) -> None:
        self._lists = [one for one in layout.lists if one.holds == "stars"]
        n = len(decoded.t_tai_ns)
        total = sum((decoded.count[one.name] for one in self._lists), np.zeros(n, np.int64))
        rows = np.maximum(total, 1)
        self._first = np.cumsum(rows) - rows
        self.packet = np.repeat(np.arange(n), rows)

    def stars(self, decoded: DecodedPackets) -> dict[str, Typed]:
        """Return the star columns."""
        place, parts = [], []
        first = self._first.copy()
        for one in self._lists:
            count = decoded.count[one.name]
            packet = np.repeat(np.arange(len(count)), count)
            within = np.arange(len(packet)) - (np.cumsum(count) - count)[packet]
            place.append(first[packet] + within)
            first += count
            exposure = _exposure(one.exposure, decoded, packet)
            parts.append(decoded.lists[one.name] | {"exposure": exposure})
        return {
            name: _joined(name, parts, place, len(self.packet))
            for name in ("exposure", *STAR_FIELDS)
        }


def _exposure(said: Any, decoded: DecodedPackets, packet: Ints) -> Typed:
    if isinstance(said, str):
        return decoded.scalars[said].take(packet)
    none = np.zeros(len(packet), np.bool_)
    return Typed(np.full(len(packet), said, np.int64), none, none)


def _joined(name: str, parts: list[dict[str, Typed]], place: list[Ints], size: int) -> Typed:
    """Return one star column of all lists, in the rows' order; empty where a list lacks it."""
    real = name not in ("exposure", "star_id")
    values = np.full(size, np.nan) if real else np.zeros(size, np.int64)
    bad, empty = np.zeros(size, np.bool_), np.ones(size, np.bool_)
    for entries, where in zip(parts, place, strict=True):
        if name in entries:
            column = entries[name]
            values[where], bad[where] = column.values, column.bad
            empty[where] = column.empty
    return Typed(values, bad, empty)


def make_decoder(layout: PacketLayout, source: SourceFile) -> Decoder:
    """Return the decoder of one file of packets; it is good for that file only."""
    is_log = cosmos.is_log(source.head, str(source.path))
    packets = PacketDecoder(layout, is_log)
    return Decoder(
        "cosmos" if is_log else "ccsds",
        extensions=(),
        sniff=lambda head: True,
        decode=packets.decode,
        context=lambda _: layout.source,
        report=packets.report,
    )


def decode_again(context: bytes) -> Again:
    """Return how packets that were kept are decoded again; the context is their layout's file.

    A packet of a log was kept without its entry.
    """
    layout = parse_layout(context, "the packet layout kept with the records")

    def decode(source: SourceFile, warn: Callable[[str], None]) -> Iterator[RowBlock]:
        decoder = PacketDecoder(layout, is_log=False, may_be_junk=True)
        return decoder.decode(source, lambda _: None)

    return Again(decode, one_by_one=True, show=partial(bytes.hex, sep=" ", bytes_per_sep=2))
