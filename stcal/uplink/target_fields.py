"""Rules that the fields of an upload target obey, each by itself and all together."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from stcal.cameras import CAMERAS
from stcal.units import unit_of

if TYPE_CHECKING:
    from stcal.uplink.target import TableField

# value -> its unit in the calibration file
FACTS = {"serial": "1", "rows": "px", "cols": "px", "pixel_size_m": "m"}
# value -> orders of its elements, the usual one first
ALIGNMENTS = {"c_sd": ("row", "column"), "q_sd": ("xyzw", "wxyz"), "q_ds": ("xyzw", "wxyz")}
_WHOLE_NUMBERS = ("serial", "rows", "cols", "constant")
# Other files of an upload directory.
_TAKEN = ("calibration.json", "parameters.csv", "manifest.json", "approval.json", "report.html",
          "rollback")  # fmt: skip
_LENGTHS = ("m", "mm", "um")
_ANGLES = ("rad", "mrad", "urad", "deg", "arcsec")


def si_unit(value: str) -> str:
    """Return the unit of a value as the calibration file holds it."""
    if value in ALIGNMENTS or value in ("constant", "padding"):
        return "1"
    return FACTS.get(value) or unit_of(value).si


def field_problems(field: TableField) -> Iterator[str]:
    """Yield what is wrong with one field, whatever the camera model."""
    yield from _word_problems(field)
    if field.order is not None and field.order not in ALIGNMENTS.get(field.value, ()):
        yield f"order {field.order!r} is not one of {field.value}"
    if field.unit is not None and _dimension(field.unit) != _dimension(si_unit(field.value)):
        yield f"unit {field.unit!r} cannot hold {field.value}, which is in {si_unit(field.value)}"
    if (field.constant is not None) != (field.value == "constant"):
        yield "constant goes with value = 'constant' and only with it"
    if (field.count is not None) != (field.value == "padding"):
        yield "count goes with value = 'padding' and only with it"
    if None not in (field.minimum, field.maximum) and field.minimum > field.maximum:  # type: ignore[operator]
        yield f"minimum {field.minimum} is above maximum {field.maximum}"


def _word_problems(field: TableField) -> Iterator[str]:
    scaled = field.scale is not None or field.fraction_bits is not None
    if field.scale is not None and field.fraction_bits is not None:
        yield "scale and fraction_bits exclude each other"
    if field.value == "padding":
        if "word" in field.model_fields_set:
            yield "padding is counted in bytes and has no word"
        return
    if "word" not in field.model_fields_set:
        yield "word is missing"
    elif field.is_float and scaled:
        yield f"a {field.word} has no scale"
    elif field.value in _WHOLE_NUMBERS:
        if field.is_float or scaled or field.unit is not None or field.offset:
            yield f"{field.value} is a whole number: an integer word, no scale, unit or offset"
        if field.constant is not None and not fits(field.constant, field.word):
            yield f"constant {field.constant} does not fit {field.word}"
    elif not field.is_float and not scaled:
        yield f"{field.value} in {field.word} needs scale or fraction_bits"


def word_bits(word: str) -> int:
    """Return the number of bits of a word such as ``uint16``."""
    return int(re.sub(r"\D", "", word))


def fits(number: int, word: str) -> bool:
    """Whether an integer word can hold a number."""
    bits = word_bits(word)
    lowest = 0 if word.startswith("uint") else -(1 << (bits - 1))
    return lowest <= number < lowest + (1 << bits)


def _dimension(unit: str) -> tuple[str, int] | None:
    """Return (base, power) of a unit such as mm, deg or mm^-4; None of an unknown one."""
    match = re.fullmatch(r"([a-z]+)(?:\^-([1-9]\d?))?", unit)
    if unit == "1":
        return "1", 0
    if match is None:
        return None
    base, power = match[1], -int(match[2]) if match[2] else 1
    if base in _LENGTHS:
        return "m", power
    if base in _ANGLES and power == 1:
        return "rad", power
    return ("px", power) if base == "px" else None


def whole_problems(document: dict[str, Any]) -> Iterator[str]:
    """Yield what is wrong with a target as a whole, from its TOML document, whatever else is."""
    sections = document.get("field")
    if not isinstance(sections, list) or not all(isinstance(s, dict) for s in sections):
        return
    names = Counter(str(s.get("name", "")).upper() for s in sections)
    yield from (f"field: {n} occurs {k} times, in any case" for n, k in names.items() if k > 1)
    model = document.get("model")
    if isinstance(model, str) and model in CAMERAS:
        yield from _value_problems(model, [str(s.get("value", "")) for s in sections])
    yield from _file_problems(document)


def _value_problems(model: str, values: list[str]) -> Iterator[str]:
    """The whole calibration, each value once."""
    parameters = CAMERAS[model].parameter_names
    known = {*parameters, *FACTS, *ALIGNMENTS, "constant", "padding"}
    yield from (f"field: value {v!r} is not known for {model}" for v in values if v not in known)
    counts = Counter(v for v in values if v not in ("constant", "padding"))
    yield from (f"field: value {v!r} occurs {k} times" for v, k in counts.items() if k > 1)
    needed = (*parameters, "serial")
    yield from (f"field: no field holds {v}" for v in needed if v not in values)
    alignments = [v for v in values if v in ALIGNMENTS]
    if len(set(alignments)) != 1:
        yield f"field: exactly one of {', '.join(ALIGNMENTS)} must be there: {alignments or 'none'}"


def _file_problems(document: dict[str, Any]) -> Iterator[str]:
    keys = (("cfe", "file"), ("fprime", "file"), ("openc3", "definition"), ("openc3", "binary"),
            ("yamcs", "file"))  # fmt: skip
    sections = [(document.get(section), key) for section, key in keys]
    files = [str(section.get(key)) for section, key in sections if isinstance(section, dict)]
    if not files:
        yield "no format: one of cfe, fprime, openc3, yamcs must be there"
    for name, count in Counter(f.lower() for f in files).items():
        if count > 1:
            yield f"file name {name} is used {count} times"
        if name in _TAKEN:
            yield f"file name {name} is taken by the upload itself"
