"""Encoder of an OpenC3 COSMOS table: the definition with the values as defaults, and the binary.

Integer words show their raw counts: a conversion that scaled them would truncate what is typed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from fractions import Fraction

from stcal.calibration import Calibration
from stcal.uplink.formats.payload import structure
from stcal.uplink.formats.words import Slot, layout, scale, unit, words
from stcal.uplink.target import Target
from stcal.uplink.target_fields import word_bits
from stcal.uplink.target_sections import Openc3Section

_TYPES = {"float": "FLOAT", "int": "INT", "uint": "UINT"}


def encode(section: Openc3Section, calibration: Calibration, target: Target) -> dict[str, bytes]:
    """Return the definition and the binary by their file names."""
    lines = [*_head(section, calibration, target), *_items(calibration, target)]
    definition = "\n".join(lines) + "\n"
    return {
        section.definition: definition.encode("ascii"),
        section.binary: structure(calibration, target),
    }


def _head(section: Openc3Section, calibration: Calibration, target: Target) -> Iterator[str]:
    folder = f"targets/{section.target}/tables"
    yield f"# {calibration.sensor_id} serial {calibration.serial}: {target.name}"
    yield f"# {folder}/config/{section.definition}, {folder}/bin/{section.binary}"
    order = f"{target.table.byte_order.upper()}_ENDIAN"
    yield f'TABLE "{section.table}" {order} KEY_VALUE "{section.description}"'


def _items(calibration: Calibration, target: Target) -> Iterator[str]:
    slots, size = layout(target)
    numbers = words(calibration, target)
    end = 0
    for slot in slots:
        yield from _padding(end, slot.offset)
        yield from _item(slot, numbers[slot.label])
        end = slot.offset + word_bits(slot.field.word) // 8
    yield from _padding(end, size)


def _padding(start: int, stop: int) -> Iterator[str]:
    """Bytes of their own: wider integers would have to be aligned as the processor's are."""
    for offset in range(start, stop):
        yield f'  APPEND_PARAMETER "PADDING_{offset}" 8 UINT 0 0 0 "padding"'
        yield "    HIDDEN"


def _item(slot: Slot, number: float | int) -> Iterator[str]:
    field = slot.field
    kind = _TYPES[field.word.rstrip("0123456789")]
    lowest, highest = _limits(slot)
    name, bits, text = slot.label.upper(), word_bits(field.word), _description(slot)
    yield f'  APPEND_PARAMETER "{name}" {bits} {kind} {lowest} {highest} {number!r} "{text}"'
    if field.value == "constant":
        yield "    UNEDITABLE"
    elif field.is_float and unit(field) != "1":
        yield f'    UNITS "{unit(field)}" "{unit(field)}"'


def _limits(slot: Slot) -> tuple[str, str]:
    """Return the limits as the item counts them; MIN and MAX are those of the word."""
    field = slot.field
    if field.value == "constant":
        return repr(field.constant), repr(field.constant)
    low, high = field.minimum, field.maximum
    if field.is_float:
        return ("MIN" if low is None else repr(low)), ("MAX" if high is None else repr(high))
    step = scale(field)
    lowest = "MIN" if low is None else str(math.ceil(Fraction(low) / step))
    highest = "MAX" if high is None else str(math.floor(Fraction(high) / step))
    return lowest, highest


def _description(slot: Slot) -> str:
    field = slot.field
    if field.value == "constant":
        return "constant"
    text = slot.quantity or ""
    if field.offset:
        text += f" + {field.offset!r} {unit(field)}"
    if field.is_float or scale(field) == 1:
        return text
    return f"{text} in counts of {float(scale(field))!r} {unit(field)}"
