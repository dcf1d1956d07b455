"""What is wrong with a packet layout as a whole: names, columns, lists."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from stcal.telemetry.columns import UNITS
from stcal.telemetry.packet_fields import (
    FRAME_FIELDS,
    STAR_FIELDS,
    WHOLE_NUMBERS,
    PacketField,
    PacketList,
)

if TYPE_CHECKING:
    from stcal.telemetry.packet_layout import PacketLayout


def name_problems(layout: PacketLayout) -> Iterator[str]:
    """Yield names and APIDs that are given more than once."""
    names = [item.name for item in layout.fields]
    for name in sorted({name for name in names if names.count(name) > 1}):
        yield f"{name}: given more than once"
    for one in layout.lists:
        inside = [field.name for field in one.fields]
        for name in sorted({name for name in inside if inside.count(name) > 1}):
            yield f"{one.name}.{name}: given more than once"
    apids = list(layout.apids.values())
    for apid in sorted({apid for apid in apids if apids.count(apid) > 1}):
        yield f"apids: {apid} is given to several sensors"
    if isinstance(layout.ignored_apids, list):
        for apid in sorted(set(apids) & set(layout.ignored_apids)):
            yield f"ignored_apids: {apid} is a sensor's"


def column_problems(layout: PacketLayout) -> Iterator[str]:
    """Yield what keeps fields from becoming telemetry columns."""
    known = {field.name for field in layout.scalars}
    if "frame_id" not in known:
        yield "no field is named frame_id"
    columns = [field for field in layout.scalars if field.name in FRAME_FIELDS]
    for one in layout.lists:
        wanted = STAR_FIELDS if one.holds == "stars" else ("star_id",)
        columns += [field for field in one.fields if field.name in wanted]
        columns += [field for field in one.fields if field.name == "star"]
    for field in columns:
        if field.name in UNITS and (problem := field.unit_problem()):
            yield problem
        if field.name in (*WHOLE_NUMBERS, "star"):
            if field.kind == "f" or not field.is_plain:
                yield f"{field.name}: is a whole number without scale and offset"
            if field.name == "star_id" and field.encoding is None:
                yield "star_id: needs encoding = hip or hip-tyc"
            if field.encoding == "hip-tyc" and field.type != "u32":
                yield "star_id: encoding hip-tyc needs type u32"
    every = [*layout.scalars, *(field for one in layout.lists for field in one.fields)]
    for field in every:
        if field.valid_if is not None and field.valid_if not in known:
            yield f"{field.name}: valid_if = {field.valid_if!r} is no field outside lists"
        if field.encoding is not None and field.name != "star_id":
            yield f"{field.name}: encoding is for star_id"


def list_problems(layout: PacketLayout) -> Iterator[str]:
    """Yield what is wrong with lists and their counts."""
    before: dict[str, PacketField] = {}
    stars: set[str] = set()
    for item in layout.fields:
        if isinstance(item, PacketField):
            before[item.name] = item
            continue
        count = before.get(item.count)
        if count is None:
            yield f"{item.name}: count = {item.count!r} is no field before it"
        elif count.kind != "u" or not count.is_plain or count.width > 32:
            yield f"{item.name}: its count {item.count} is not a plain u1 to u32"
        if item.holds == "stars":
            stars.add(item.name)
            yield from _stars_problems(item, {field.name for field in layout.scalars})
        else:
            yield from _matches_problems(item, stars)
    if not stars:
        yield "there is no list of stars"


def _stars_problems(one: PacketList, scalars: set[str]) -> Iterator[str]:
    missing = [name for name in ("row_px", "col_px") if one.field(name) is None]
    if missing:
        yield f"{one.name}: no field is named {' or '.join(missing)}"
    if one.exposure is None:
        yield f"{one.name}: exposure is missing: 0, 1 or the field that says it"
    if isinstance(one.exposure, str) and one.exposure not in scalars:
        yield f"{one.name}: exposure = {one.exposure!r} is no field outside lists"
    if one.of is not None:
        yield f"{one.name}: of is for matches"


def _matches_problems(one: PacketList, stars: set[str]) -> Iterator[str]:
    missing = [name for name in ("star", "star_id") if one.field(name) is None]
    if missing:
        yield f"{one.name}: no field is named {' or '.join(missing)}"
    if one.of not in stars:
        yield f"{one.name}: of = {one.of!r} is no list of stars before it"
    if one.exposure is not None:
        yield f"{one.name}: exposure is for stars"
