"""Encoders' side of the words: what the target holds for each field, and where.

Arithmetic is exact (fractions) up to the one rounding into the word.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from stcal.calibration import Calibration
from stcal.errors import InputError
from stcal.uplink.quantities import quantities
from stcal.uplink.target import TableField, Target
from stcal.uplink.target_fields import ALIGNMENTS, fits, si_unit

CODES = {"float32": "f", "float64": "d", "int8": "b", "int16": "h", "int32": "i", "int64": "q",
         "uint8": "B", "uint16": "H", "uint32": "I", "uint64": "Q"}  # fmt: skip
_BASES = {
    "m": Fraction(1), "mm": Fraction(1, 1000), "um": Fraction(1, 10**6),
    "rad": Fraction(1), "mrad": Fraction(1, 1000), "urad": Fraction(1, 10**6),
    "deg": Fraction(math.pi) / 180, "arcsec": Fraction(math.pi) / 648000, "px": Fraction(1),
}  # fmt: skip
_ORDERS = {
    "row": tuple(f"{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)),
    "column": tuple(f"{i}{j}" for j in (1, 2, 3) for i in (1, 2, 3)),
    "xyzw": tuple("xyzw"),
    "wxyz": tuple("wxyz"),
}


class EncodeError(InputError):
    """A calibration that the target cannot hold."""

    def __init__(self, reasons: list[str]) -> None:
        """``reasons`` : all that is wrong."""
        super().__init__("; ".join(reasons))
        self.reasons = reasons


@dataclass(frozen=True)
class Slot:
    """One number of the structure.

    Attributes
    ----------
    label : the field's name, with the element: ``alignment_12``
    quantity : what it holds, by the names of stcal.uplink.quantities; None of a constant
    offset : byte in the payload
    """

    field: TableField
    label: str
    quantity: str | None
    offset: int


def layout(target: Target) -> tuple[list[Slot], int]:
    """Return the numbers of the structure and its size in bytes, as a C compiler lays it out."""
    slots: list[Slot] = []
    end, widest = 0, 1
    for field in target.members:
        if field.value == "padding":
            end += field.count or 0
            continue
        size = struct.calcsize("=" + CODES[field.word])
        alignment = min(size, target.table.alignment)
        widest = max(widest, alignment)
        end = _aligned(end, alignment)
        for label, quantity in _elements(field):
            slots.append(Slot(field, label, quantity, end))
            end += size
    return slots, _aligned(end, widest)


def _aligned(end: int, alignment: int) -> int:
    return -(-end // alignment) * alignment


def _elements(field: TableField) -> Iterator[tuple[str, str | None]]:
    """Yield the label and the quantity of each element of a field."""
    if field.value == "constant":
        yield field.name, None
    elif field.value in ALIGNMENTS:
        for element in _ORDERS[field.order or ALIGNMENTS[field.value][0]]:
            yield f"{field.name}_{element}", f"{field.value}_{element}"
    else:
        yield field.name, field.value


def unit(field: TableField) -> str:
    """Return the unit of the number on the target."""
    return field.unit or si_unit(field.value)


def scale(field: TableField) -> Fraction:
    """Return the value of one count of an integer word, in the field's unit."""
    if field.fraction_bits is not None:
        return Fraction(1, 2**field.fraction_bits)
    return Fraction(1) if field.scale is None else Fraction(repr(field.scale))


def words(calibration: Calibration, target: Target) -> dict[str, float | int]:
    """Return label -> what the word holds.

    Raises
    ------
    OverflowError, ValueError
        On numbers that :func:`number_problems` tells of.
    """
    numbers = quantities(calibration)
    return {slot.label: _word(slot, numbers) for slot in layout(target)[0]}


def number_problems(calibration: Calibration, target: Target) -> list[str]:
    """Return why numbers of a calibration cannot be words of the target."""
    numbers = quantities(calibration)
    return [p for slot in layout(target)[0] for p in _slot_problems(slot, numbers)]


def _slot_problems(slot: Slot, numbers: dict[str, float | int]) -> Iterator[str]:
    field = slot.field
    name = slot.label if slot.quantity in (None, slot.label) else f"{slot.label} ({slot.quantity})"
    value = _value(slot, numbers)
    if not math.isfinite(value):
        yield f"{name} is {value!r}"
        return
    number = _on_target(field, value)
    shown = f"{float(number):.9g} {unit(field)}" if abs(number) < 10**300 else "too large"
    try:
        _word(slot, numbers)
    except OverflowError:
        yield f"{name} = {value!r} does not fit {field.word}: {shown}"
    if field.minimum is not None and number < Fraction(field.minimum):
        yield f"{name} is {shown}, below the target's minimum {field.minimum:g}"
    if field.maximum is not None and number > Fraction(field.maximum):
        yield f"{name} is {shown}, above the target's maximum {field.maximum:g}"


def _value(slot: Slot, numbers: dict[str, float | int]) -> float | int:
    if slot.quantity is None:
        return slot.field.constant or 0
    return numbers[slot.quantity]


def _on_target(field: TableField, value: float | int) -> Fraction:
    """Return the exact number in the field's unit, its offset added."""
    return Fraction(value) / _unit_size(unit(field)) + Fraction(repr(field.offset))


def _unit_size(name: str) -> Fraction:
    """Return one of a unit such as mm or mm^-4 in SI."""
    if name == "1":
        return Fraction(1)
    base, _, power = name.partition("^")
    return _BASES[base] ** int(power or 1)


def _word(slot: Slot, numbers: dict[str, float | int]) -> float | int:
    """Return the nearest number that the word can hold, ties to even."""
    field = slot.field
    number = _on_target(field, _value(slot, numbers))
    if field.word == "float64":
        return float(number) + 0.0  # no negative zeros
    if field.word == "float32":
        return _float32(number)
    counts = round(number / scale(field))
    if not fits(counts, field.word):
        raise OverflowError
    return counts


def _float32(number: Fraction) -> float:
    """Return the nearest single; by way of a double it would be rounded twice."""
    (near,) = struct.unpack("=f", struct.pack("=f", float(number)))
    around = (np.nextafter(np.float32(near), np.float32(side)) for side in (-np.inf, np.inf))
    candidates = [near, *(float(x) for x in around if np.isfinite(x))]
    nearest = min(candidates, key=lambda x: (abs(Fraction(x) - number), _odd(x)))
    return float(nearest) + 0.0


def _odd(single: float) -> int:
    return int.from_bytes(struct.pack(">f", single), "big") & 1
