"""Frames to packets: what the simulator's sensor sends, and the opposite of the decoder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal import atomic
from stcal.constants import EXPOSURES_PER_FRAME
from stcal.errors import InputError
from stcal.frames import Bools, Floats, FrameBatch, Ints, take_ranges
from stcal.telemetry import packet_kernels as kernels
from stcal.telemetry.columns import FLAGS, VECTORS
from stcal.telemetry.packet_fields import FRAME_FIELDS, STAR_FIELDS, PacketField, PacketList
from stcal.telemetry.packet_layout import CRC_BYTES, PRIMARY_HEADER_BYTES, PacketLayout
from stcal.telemetry.packet_stars import raw_numbers
from stcal.telemetry.packet_time import from_tai_ns

Bytes = NDArray[np.uint8]
Raw = NDArray[np.uint64]


def encode_packets(
    layout: PacketLayout,
    frames: FrameBatch,
    first_sequence: int = 0,
    first_pixel_centre_px: float = 0.0,
) -> bytes:
    """Return frames as packets back to back, numbered from ``first_sequence``, a packet a frame.

    Raises
    ------
    InputError
        Naming the layout and the field: a value that it cannot say, more stars than its list
        holds, or no APID for the sensor.
    """
    return _Encoder(layout, frames, first_pixel_centre_px).packets(first_sequence)


def write_packets(
    layout: PacketLayout,
    frames: FrameBatch,
    path: Path,
    first_pixel_centre_px: float = 0.0,
    first_sequence: int = 0,
) -> None:
    """Write the packets of frames to a file, in one step."""
    packets = encode_packets(layout, frames, first_sequence, first_pixel_centre_px)
    atomic.write_bytes(path, packets)


@dataclass(frozen=True)
class _Entries:
    """The entries of a list: its count in each packet, and the columns by field."""

    count: Ints
    columns: dict[str, Any]


class _Encoder:
    def __init__(self, layout: PacketLayout, frames: FrameBatch, first_pixel: float) -> None:
        self._layout, self._frames, self._first_pixel = layout, frames, first_pixel
        if layout.frames_span_packets:
            raise InputError(f"{layout.name}: packets of one exposure each cannot be written")
        if frames.sensor_id not in layout.apids:
            raise InputError(f"{layout.name}: no APID for sensor {frames.sensor_id}")
        self._lists: dict[str, _Entries] = {}
        for one in layout.lists:
            self._lists[one.name] = self._entries(one)
        self._segment, self._total = self._places()
        self._start = np.cumsum(self._total) - self._total
        self._segment += 8 * self._start[:, None]
        self._data: Bytes = np.zeros(int(self._total.sum()), np.uint8)

    def packets(self, first_sequence: int) -> bytes:
        """Fill in the parts and return the bytes."""
        self._fill_header(first_sequence)
        self._fill_time()
        values = self._scalar_values()
        for field in self._layout.scalars:
            segment, bit = self._layout.places[field.name]
            self._put(self._segment[:, segment] + bit, None, 0, field, values[field.name])
        for k, one in enumerate(self._layout.lists):
            self._fill_list(k, one)
        if self._layout.has_crc:
            self._fill_crc()
        return self._data.tobytes()

    def _places(self) -> tuple[Ints, Ints]:
        """Return the bit of each segment from its packet's first one, and the packets' bytes."""
        layout = self._layout
        segment = np.zeros((self._frames.n_frames, len(layout.lists) + 1), np.int64)
        for k, one in enumerate(layout.lists):
            count = self._lists[one.name].count
            there = np.full_like(count, one.maximum) if one.always_full else count
            segment[:, k + 1] = segment[:, k] + layout.segment_bits[k] + there * one.stride
        bits = segment[:, -1] + layout.segment_bits[-1]
        return segment, (bits + 7) // 8 + CRC_BYTES * layout.has_crc

    def _entries(self, one: PacketList) -> _Entries:
        frames = self._frames
        if one.holds == "matches":
            stars = self._lists[str(one.of)]
            packet = np.repeat(np.arange(len(stars.count)), stars.count)
            code = stars.columns["star_id"]
            index = np.arange(len(packet)) - (np.cumsum(stars.count) - stars.count)[packet]
            matched = code > 0
            columns = {"star": index[matched] + one.first_index, "star_id": code[matched]}
            entries = _Entries(np.bincount(packet[matched], minlength=frames.n_frames), columns)
        else:
            exposure = EXPOSURES_PER_FRAME * np.arange(frames.n_frames) + int(one.exposure or 0)
            which, offsets = take_ranges(frames.star_offsets, exposure)
            columns = {name: getattr(frames, name)[which] for name in STAR_FIELDS}
            for axis in ("row_px", "col_px"):
                columns[axis] = columns[axis] + self._first_pixel
            entries = _Entries(np.diff(offsets), columns)
        if np.any(entries.count > one.maximum):
            most = int(entries.count.max())
            raise InputError(
                f"{self._layout.name}: {one.name} holds {one.maximum} entries, a frame has {most}"
            )
        return entries

    def _fill_header(self, first_sequence: int) -> None:
        n = self._frames.n_frames
        apid = self._layout.apids[self._frames.sensor_id]
        sequence = (first_sequence + np.arange(n)) % 16384
        words = np.column_stack(
            (np.full(n, 0x0800 | apid), 0xC000 | sequence, self._total - PRIMARY_HEADER_BYTES - 1)
        )
        self._write_bytes(0, words.astype(">u2").view(np.uint8).reshape(n, -1))

    def _fill_time(self) -> None:
        try:
            parts = from_tai_ns(self._layout.time, self._frames.t_tai_ns)
        except ValueError as error:
            raise InputError(f"{self._layout.name}: {error}") from None
        place = PRIMARY_HEADER_BYTES
        for name, size in self._layout.time.widths:
            content = parts[name].astype(">u8").view(np.uint8).reshape(-1, 8)[:, 8 - size :]
            self._write_bytes(place, content)
            place += size

    def _write_bytes(self, place: int, content: Bytes) -> None:
        self._data[self._start[:, None] + place + np.arange(content.shape[1])] = content

    def _fill_list(self, k: int, one: PacketList) -> None:
        entries = self._lists[one.name]
        first = self._segment[:, k] + self._layout.segment_bits[k]
        size = int(entries.count.sum())
        for field in one.fields:
            value = entries.columns.get(field.name, np.zeros(size, np.int64))
            raw = self._raw(field, value, f"{one.name}.{field.name}")
            self._put(first + one.offset_of(field.name), entries.count, one.stride, field, raw)

    def _put(
        self, start: Ints, count: Ints | None, stride: int, field: PacketField, raw: Raw
    ) -> None:
        each = np.ones(len(start), np.int64) if count is None else count
        little = self._layout.is_little(field)
        kernels.pack(self._data, start, each, stride, field.width, little, raw)

    def _fill_crc(self) -> None:
        crc = np.empty(len(self._start), np.int64)
        for i, (start, total) in enumerate(zip(self._start, self._total, strict=True)):
            crc[i] = kernels.crc16(self._data, start, start + total - CRC_BYTES)
        last = self._start + self._total
        self._data[last - 2], self._data[last - 1] = crc >> 8, crc & 0xFF

    def _scalar_values(self) -> dict[str, Raw]:
        """Return the raw numbers of the fields outside lists."""
        columns = _frame_columns(self._frames)
        flags: dict[str, Bools] = {}
        for field in self._layout.scalars:
            if field.valid_if is not None and field.name in columns:
                there = ~_missing(columns[field.name])
                flags[field.valid_if] = flags.get(field.valid_if, there) & there
        columns |= {one.count: self._lists[one.name].count for one in self._layout.lists}
        columns |= {name: flag.astype(np.int64) for name, flag in flags.items()}
        none = np.zeros(self._frames.n_frames, np.int64)
        return {
            field.name: self._raw(field, columns.get(field.name, none), field.name)
            for field in self._layout.scalars
        }

    def _raw(self, field: PacketField, value: Any, where: str) -> Raw:
        """Return the raw numbers of a column's values."""
        if field.encoding is not None:
            try:
                return raw_numbers(value, field.encoding)
            except ValueError as error:
                raise InputError(f"{self._layout.name}: {where}: {error}") from None
        missing = _missing(value) if field.name in FRAME_FIELDS + STAR_FIELDS else value < 0
        if field.valid_if is None and field.empty is None and missing.any():
            raise InputError(f"{self._layout.name}: {where}: no number stands for an empty value")
        factor, shift = field.conversion
        there = np.where(missing, field.offset, value)
        number = there if (factor, shift) == (1.0, 0.0) else (there - shift) / factor
        if not field.is_plain:
            number = (number - field.offset) / field.scale
        raw = self._bits_of(field, number, where)
        if field.empty is not None:
            raw[missing] = _empty_bits(field)
        else:
            raw[missing] = 0
        return raw

    def _bits_of(self, field: PacketField, number: Floats | Ints, where: str) -> Raw:
        if field.kind == "f":
            return _float_bits(field, number)
        whole = np.rint(number)
        low = -(2 ** (field.width - 1)) if field.kind == "i" else 0
        if np.any(whole < low) or np.any(whole >= low + 2**field.width):
            raise InputError(
                f"{self._layout.name}: {where}: a value from {number.min():g} to "
                f"{number.max():g} counts does not fit {field.type}"
            )
        mask = np.uint64(2**field.width - 1)
        if field.kind == "u":
            return whole.astype(np.uint64) & mask
        return whole.astype(np.int64).view(np.uint64) & mask


def _missing(value: Any) -> Bools:
    return np.asarray(np.isnan(value) if value.dtype.kind == "f" else value == -1)


def _float_bits(field: PacketField, number: Any) -> Raw:
    if field.width == 64:
        return np.asarray(number, np.float64).view(np.uint64).copy()
    return np.asarray(number, np.float32).view(np.uint32).astype(np.uint64)


def _empty_bits(field: PacketField) -> np.uint64:
    if field.kind == "f":
        return np.uint64(_float_bits(field, np.array([field.empty]))[0])
    return np.uint64(int(field.empty or 0) % 2**field.width)


def _frame_columns(frames: FrameBatch) -> dict[str, Any]:
    """Return the columns of frames by telemetry name; -1 or NaN where there is no value."""
    columns: dict[str, Any] = {
        "frame_id": frames.frame_id,
        "best_exposure": frames.best_exposure.astype(np.int64),
        "temperature_c": frames.temperature_c,
    }
    columns |= {name: getattr(frames, name).astype(np.int64) for name in FLAGS}
    for key, names in VECTORS.items():
        columns |= {name: getattr(frames, key)[:, i] for i, name in enumerate(names)}
    return columns
