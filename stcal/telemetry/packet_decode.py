"""Framed packets to columns: the layout's program, raw numbers, values in the columns' units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.catalog.identifiers import MALFORMED
from stcal.frames import Bools, Floats, Ints
from stcal.telemetry import packet_kernels as kernels
from stcal.telemetry.columns import FLAGS
from stcal.telemetry.packet_fields import (
    FRAME_FIELDS,
    STAR_FIELDS,
    WHOLE_NUMBERS,
    PacketField,
    PacketList,
)
from stcal.telemetry.packet_layout import CRC_BYTES, IDLE_APID, PRIMARY_HEADER_BYTES, PacketLayout
from stcal.telemetry.packet_stars import star_codes
from stcal.telemetry.packet_time import to_tai_ns
from stcal.telemetry.typed import Typed

Bytes = NDArray[np.uint8]
Raw = NDArray[np.uint64]
UNSEGMENTED = 3
_APIDS = 2048


def make_program(layout: PacketLayout) -> kernels.Program:
    """Return the layout as the kernels read it."""
    any_other = layout.ignored_apids == "any"
    kind = np.full(_APIDS, kernels.IGNORED if any_other else kernels.NOT_OURS, np.int64)
    if isinstance(layout.ignored_apids, list):
        kind[layout.ignored_apids] = kernels.IGNORED
    kind[IDLE_APID] = kernels.IGNORED
    kind[list(layout.apids.values())] = kernels.OURS
    lists = layout.lists
    counts = [layout.scalar(one.count) for one in lists]
    places = [layout.places[one.count] for one in lists]
    return kernels.Program(
        kind=kind,
        smallest=layout.smallest,
        largest=layout.largest,
        crc_bytes=CRC_BYTES * layout.has_crc,
        segment_bits=_ints(layout.segment_bits),
        stride=_ints([one.stride for one in lists]),
        maximum=_ints([one.maximum for one in lists]),
        full=_ints([one.always_full for one in lists]),
        count_segment=_ints([segment for segment, _ in places]),
        count_bit=_ints([bit for _, bit in places]),
        count_width=_ints([field.width for field in counts]),
        count_little=_ints([layout.is_little(field) for field in counts]),
    )


def _ints(values: object) -> Ints:
    return np.asarray(values, dtype=np.int64)


@dataclass(frozen=True)
class Places:
    """Where the parts of n packets are.

    Attributes
    ----------
    segment : (n, L + 1) bit at which each segment begins
    count : (n, L) length of each list
    fits : (n,) kernels.FITS, or how the lists do not fit the packet's length
    """

    segment: Ints
    count: Ints
    fits: Ints

    def take(self, index: Bools) -> Places:
        """Return the selected packets."""
        return Places(self.segment[index], self.count[index], self.fits[index])


def find_places(program: kernels.Program, data: Bytes, start: Ints, total: Ints) -> Places:
    """Return the places of the packets that begin at ``start`` and have ``total`` bytes."""
    n, lists = len(start), len(program.stride)
    segment, count = np.zeros((n, lists + 1), np.int64), np.zeros((n, lists), np.int64)
    fits = np.zeros(n, np.int64)
    kernels.measure(data, start, total, program, segment, count, fits)
    return Places(segment, count, fits)


@dataclass(frozen=True)
class PacketHeaders:
    """Primary headers (n,): APID, sequence flags, sequence count."""

    apid: Ints
    flags: Ints
    sequence: Ints


def headers_of(data: Bytes, start: Ints) -> PacketHeaders:
    """Return the headers of the packets that begin at ``start``."""
    at = data[start[:, None] + np.arange(4)].astype(np.int64)
    return PacketHeaders(
        apid=(at[:, 0] & 7) << 8 | at[:, 1],
        flags=at[:, 2] >> 6,
        sequence=(at[:, 2] & 0x3F) << 8 | at[:, 3],
    )


@dataclass(frozen=True)
class DecodedPackets:
    """Columns of n packets, and of their lists' entries.

    Attributes
    ----------
    t_tai_ns : (n,) time of each packet, ``bad`` where it is none
    scalars : by the field's name
    lists : by the list's name, then the field's; entry after entry, packet after packet
    count : (n,) entries of each list, by its name
    match_problem : (n,) whether a match points beyond its list of stars, or two at one star
    """

    t_tai_ns: Typed
    scalars: dict[str, Typed]
    lists: dict[str, dict[str, Typed]]
    count: dict[str, Ints]
    match_problem: Bools


def decode_packets(layout: PacketLayout, data: Bytes, places: Places) -> DecodedPackets:
    """Decode packets whose lists fit; matches are entered into their stars' ``star_id``."""
    count = {one.name: places.count[:, k] for k, one in enumerate(layout.lists)}
    scalars = _scalars(layout, data, places)
    lists = {
        one.name: _entries(layout, one, data, places.segment[:, k], places.count[:, k], k, scalars)
        for k, one in enumerate(layout.lists)
    }
    t_tai_ns, bad = to_tai_ns(layout.time, _time_parts(layout, data, places))
    problem = np.zeros(len(places.fits), np.bool_)
    for one in layout.lists:
        if one.holds == "matches":
            problem |= _enter_matches(one, lists, count)
    return DecodedPackets(Typed(t_tai_ns, bad, np.zeros_like(bad)), scalars, lists, count, problem)


def _time_parts(layout: PacketLayout, data: Bytes, places: Places) -> dict[str, Raw]:
    parts = {}
    bit = places.segment[:, 0] + 8 * PRIMARY_HEADER_BYTES
    for name, size in layout.time.widths:
        parts[name] = _read(data, bit, None, 0, 8 * size, False)
        bit = bit + 8 * size
    return parts


def _read(
    data: Bytes, start: Ints, count: Ints | None, stride: int, width: int, little: bool
) -> Raw:
    """Return raw numbers; ``count`` None: one each."""
    each = np.ones(len(start), np.int64) if count is None else count
    out = np.empty(int(each.sum()), np.uint64)
    kernels.unpack(data, start, np.ascontiguousarray(each), stride, width, little, out)
    return out


def _scalars(layout: PacketLayout, data: Bytes, places: Places) -> dict[str, Typed]:
    """Return the columns of the fields outside lists."""
    raw, found = {}, {}
    for field in layout.scalars:
        segment, bit = layout.places[field.name]
        start = places.segment[:, segment] + bit
        raw[field.name] = _read(data, start, None, 0, field.width, layout.is_little(field))
    for field in layout.scalars:
        valid = None if field.valid_if is None else raw[field.valid_if] != 0
        found[field.name] = column_of(field, raw[field.name], valid)
    return found


def _entries(
    layout: PacketLayout,
    one: PacketList,
    data: Bytes,
    segment: Ints,
    count: Ints,
    k: int,
    scalars: dict[str, Typed],
) -> dict[str, Typed]:
    """Return the columns of a list's entries."""
    used = STAR_FIELDS if one.holds == "stars" else ("star", "star_id")
    first = segment + layout.segment_bits[k]
    found = {}
    for field in one.fields:
        if field.name not in used:
            continue
        start = first + one.offset_of(field.name)
        raw = _read(data, start, count, one.stride, field.width, layout.is_little(field))
        valid = None
        if field.valid_if is not None:
            valid = np.repeat(scalars[field.valid_if].values != 0, count)
        found[field.name] = column_of(field, raw, valid)
    return found


def physical(field: PacketField, raw: Raw) -> Floats | Ints | Raw:
    """Return the values of raw numbers in the field's own unit; whole ones stay whole."""
    number: Floats | Ints | Raw = raw
    if field.kind == "i":
        unused = np.int64(64 - field.width)
        number = (raw << np.uint64(unused)).view(np.int64) >> unused
    elif field.kind == "f":
        number = raw.view(np.float64) if field.width == 64 else _singles(raw)
    if field.is_plain:
        return number
    value = number.astype(np.float64)
    if field.scale != 1.0:
        value *= field.scale
    if field.offset != 0.0:
        value += field.offset
    return value


def _singles(raw: Raw) -> Floats:
    return raw.astype(np.uint32).view(np.float32).astype(np.float64)


def _is_empty(field: PacketField, raw: Raw) -> Bools:
    if field.empty is None:
        return np.zeros(len(raw), np.bool_)
    if field.kind != "f":
        return np.asarray(raw == np.uint64(int(field.empty) % 2**field.width))
    number = raw.view(np.float64) if field.width == 64 else _singles(raw)
    return np.asarray(np.isnan(number) if np.isnan(field.empty) else number == field.empty)


def column_of(field: PacketField, raw: Raw, valid: Bools | None = None) -> Typed:
    """Return raw numbers as the telemetry column of the field's name, in that column's unit."""
    empty = _is_empty(field, raw)
    if valid is not None:
        empty = empty | ~valid
    if field.encoding is not None:
        codes = np.where(empty, 0, star_codes(raw, field.encoding))
        return Typed(codes, codes == MALFORMED, codes == 0)
    value = physical(field, raw)
    if field.name in (*WHOLE_NUMBERS, "star") or field.name not in (*FRAME_FIELDS, *STAR_FIELDS):
        return _whole(field, value, empty)
    factor, shift = field.conversion
    number = value.astype(np.float64, copy=False)
    if (factor, shift) != (1.0, 0.0):
        number = factor * number + shift
    number = number + 0.0  # -0.0 becomes 0.0, as in text
    bad = ~np.isfinite(number) & ~empty if field.kind == "f" else np.zeros_like(empty)
    if empty.any() or bad.any():
        number[empty | bad] = np.nan
    return Typed(number, bad, empty)


def _whole(field: PacketField, value: Floats | Ints | Raw, empty: Bools) -> Typed:
    if value.dtype == np.float64:
        return Typed(value, np.zeros_like(empty), empty)
    bad = np.zeros_like(empty) if value.dtype == np.int64 else value >= np.uint64(10**18)
    if field.name in FLAGS:
        bad = bad | (value > 1)
    bad = bad & ~empty
    return Typed(np.where(empty | bad, 0, value).astype(np.int64), bad, empty)


def _enter_matches(
    one: PacketList, lists: dict[str, dict[str, Typed]], count: dict[str, Ints]
) -> Bools:
    """Put the identifiers of a list of matches to its stars; return the packets where none fit."""
    stars = lists[str(one.of)]
    per_packet, of_stars = count[one.name], count[str(one.of)]
    packet = np.repeat(np.arange(len(per_packet)), per_packet)
    matches = lists[one.name]
    index = matches["star"].values - one.first_index
    outside = (index < 0) | (index >= of_stars[packet]) | matches["star"].bad
    first = np.cumsum(of_stars) - of_stars
    star = first[packet] + np.where(outside, 0, index)
    bad = np.zeros(len(per_packet), np.bool_)
    bad[packet[outside]] = True
    order = np.sort(star[~outside])
    again = order[1:][np.diff(order) == 0]
    bad[np.searchsorted(np.cumsum(of_stars), again, side="right")] = True
    given = stars.get("star_id")
    size = int(of_stars.sum())
    codes = np.zeros(size, np.int64) if given is None else given.values.copy()
    codes[star[~outside]] = matches["star_id"].values[~outside]
    stars["star_id"] = Typed(codes, codes == MALFORMED, codes == 0)
    return bad
