"""A packet layout explained: every part with its place, range, resolution and use."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from stcal.telemetry.columns import UNITS
from stcal.telemetry.packet_fields import FRAME_FIELDS, STAR_FIELDS, PacketField, PacketList
from stcal.telemetry.packet_layout import PRIMARY_HEADER_BYTES, PacketLayout
from stcal.telemetry.packet_xtce import combinations


def describe(layout: PacketLayout) -> dict[str, Any]:
    """Return what there is to know about a layout as a JSON document."""
    return {
        "name": layout.name,
        "description": layout.description,
        "apids": layout.apids,
        "ignored_apids": layout.ignored_apids,
        "byte_order": layout.byte_order,
        "error_control": layout.error_control,
        "packet_bytes": {"smallest": layout.smallest, "largest": layout.largest},
        "list_length_combinations": combinations(layout),
        "time": _time(layout),
        "parts": list(_parts(layout)),
    }


def _time(layout: PacketLayout) -> dict[str, Any]:
    code = layout.time
    return {
        "code": code.code,
        "epoch": code.epoch,
        "scale": code.scale,
        "bytes": code.length,
        "preamble": f"{code.preamble:02x}" if code.p_field else None,
        "resolution_ns": code.resolution_ns,
    }


def _parts(layout: PacketLayout) -> Iterator[dict[str, Any]]:
    """Yield the parts in their order; bits count from the packet's start or the last list's end."""
    yield {"part": "primary header", "after": None, "bit": 0, "bits": 8 * PRIMARY_HEADER_BYTES}
    bit = 8 * PRIMARY_HEADER_BYTES
    yield {"part": "time code", "after": None, "bit": bit, "bits": 8 * layout.time.length}
    after, bit = None, bit + 8 * layout.time.length
    for item in layout.fields:
        if isinstance(item, PacketList):
            yield _list(layout, item, after, bit)
            after, bit = item.name, 0
        else:
            yield {"part": item.name, "after": after, "bit": bit} | _field(layout, item)
            bit += item.width
    if layout.has_crc:
        yield {"part": "CRC-16", "after": after, "bit": None, "bits": 16}


def _list(layout: PacketLayout, one: PacketList, after: str | None, bit: int) -> dict[str, Any]:
    return {
        "part": one.name,
        "after": after,
        "bit": bit,
        "list": one.holds,
        "count": one.count,
        "maximum": one.maximum,
        "always_full": one.always_full,
        "exposure": one.exposure,
        "of": one.of,
        "entry_bits": one.stride,
        "fields": [
            {"part": field.name, "bit": one.offset_of(field.name)} | _field(layout, field)
            for field in one.fields
        ],
    }


def _field(layout: PacketLayout, field: PacketField) -> dict[str, Any]:
    limits = _limits(field)
    return {
        "bits": field.width,
        "type": field.type,
        "byte_order": "little" if layout.is_little(field) else "big",
        "unit": field.unit,
        "scale": field.scale,
        "offset": field.offset,
        "smallest": None if limits is None else limits[0],
        "largest": None if limits is None else limits[1],
        # TOML's nan is no JSON.
        "empty": "nan" if field.empty != field.empty else field.empty,
        "valid_if": field.valid_if,
        "encoding": field.encoding,
        "column": field.name if field.name in (*FRAME_FIELDS, *STAR_FIELDS) else None,
        "column_unit": UNITS.get(field.name),
        "description": field.description,
    }


def _limits(field: PacketField) -> tuple[float, float] | None:
    """Return the smallest and the largest value of a whole number in the field's unit."""
    if field.kind == "f" or field.encoding is not None:
        return None
    low = -(2 ** (field.width - 1)) if field.kind == "i" else 0
    ends = [raw * field.scale + field.offset for raw in (low, low + 2**field.width - 1)]
    return min(ends), max(ends)
