"""Decode the files of an upload and compare what they say with the calibration and the target."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from math import ceil, floor
from typing import Any

from stcal.calibration import Calibration
from stcal.uplink.decode import DecodeError
from stcal.uplink.formats.cfe import header_time
from stcal.uplink.formats.read_cfe import read_image
from stcal.uplink.formats.read_fprime import read_parameter
from stcal.uplink.formats.read_openc3 import Definition, Item, read_definition
from stcal.uplink.formats.read_words import (
    Place,
    Reading,
    places,
    read_numbers,
    reading,
    word_of,
)
from stcal.uplink.formats.read_yamcs import StackedCommand, number_of_argument, read_stack
from stcal.uplink.quantities import quantities
from stcal.uplink.target import TableField, Target
from stcal.uplink.target_sections import (
    CfeSection,
    FprimeSection,
    Openc3Section,
    YamcsSection,
)

_KINDS = {"f": "FLOAT", "i": "INT", "u": "UINT"}


@dataclass(frozen=True)
class ReadBack:
    """What the files of one format say: numbers, payloads by file, and what is wrong with them."""

    numbers: list[Reading]
    payloads: dict[str, bytes] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)


def read_back(
    files: Mapping[str, bytes], calibration: Calibration, target: Target
) -> dict[str, ReadBack]:
    """Decode every format that the target declares; never raises."""
    result = {}
    for name, reader in _READERS.items():
        section = getattr(target, name)
        if section is None:
            continue
        try:
            found = reader(section, files, calibration, target)
        except DecodeError as error:
            found = ReadBack([], problems=[str(error)])
        except KeyError as error:
            found = ReadBack([], problems=[f"{error.args[0]}: missing"])
        wrong = number_differences(found.numbers, calibration)
        lines = [f"{name}: {line}" for line in [*found.problems, *wrong]]
        result[name] = ReadBack(found.numbers, found.payloads, lines)
    return result


def number_differences(readings: list[Reading], calibration: Calibration) -> Iterator[str]:
    """Yield every number that is not the word nearest to the calibration's."""
    numbers = quantities(calibration)
    for r in readings:
        meaning = r.place.meaning
        given = r.place.field.constant or 0 if meaning == "constant" else numbers[meaning]
        if not _nearest(r, Fraction(given)):
            yield (
                f"{r.place.label} is {r.number!r}, that is {float(r.value)!r}; the calibration "
                f"has {given!r}"
            )


def _nearest(found: Reading, value: Fraction) -> bool:
    """Whether no other word is nearer to the value; of two equally near ones, the even one."""
    error = abs(found.value - value)
    gaps = [abs(n - value) for n in (found.below, found.above) if n is not None]
    return all(error < gap or (error == gap and found.even) for gap in gaps)


def _cfe(
    section: CfeSection, files: Mapping[str, bytes], calibration: Calibration, target: Target
) -> ReadBack:
    image = read_image(files[section.file])
    seconds, subseconds = header_time(calibration, section)
    expected: dict[str, Any] = {
        "spacecraft": section.spacecraft_id, "processor": section.processor_id,
        "application": section.application_id, "seconds": seconds, "subseconds": subseconds,
        "description": section.description, "table name": section.table_name,
    }  # fmt: skip
    problems = list(_facts("header", image.header, expected))
    numbers = read_numbers(image.payload, target)
    return ReadBack(numbers, {section.file: image.payload}, problems)


def _fprime(
    section: FprimeSection, files: Mapping[str, bytes], calibration: Calibration, target: Target
) -> ReadBack:
    found = read_parameter(files[section.file], section.crc_prefix)
    facts = _facts("record", {"id": found.identifier}, {"id": section.parameter_id})
    numbers = read_numbers(found.value, target, packed=True)
    return ReadBack(numbers, {section.file: found.value}, list(facts))


def _openc3(
    section: Openc3Section, files: Mapping[str, bytes], calibration: Calibration, target: Target
) -> ReadBack:
    binary = files[section.binary]
    definition = read_definition(files[section.definition])
    expected = {
        "table": section.table,
        "byte_order": target.table.byte_order,
        "description": section.description,
    }
    found = {key: getattr(definition, key) for key in expected}
    problems = [*_facts("definition", found, expected), *_item_problems(definition, target)]
    problems += _default_problems(definition, binary)
    return ReadBack(read_numbers(binary, target), {section.binary: binary}, problems)


def _item_problems(definition: Definition, target: Target) -> Iterator[str]:
    """Compare name, place, type and limits of the items with the target's structure."""
    found, offset = {}, 0
    for item in definition.items:
        if "HIDDEN" not in item.flags:
            found[offset] = _described(item)
        offset += item.bits // 8
    where, size = places(target)
    if offset != size:
        yield f"definition: {offset} bytes, the target's structure has {size}"
    expected = {place.offset: _expected(place) for place in where}
    for key in sorted(set(found) | set(expected)):
        if found.get(key) != expected.get(key):
            yield f"definition: byte {key} is {found.get(key)}, should be {expected.get(key)}"


def _default_problems(definition: Definition, binary: bytes) -> Iterator[str]:
    """Compare the defaults with the binary, item by item."""
    whole, offset = definition.binary(), 0
    if len(whole) != len(binary):
        yield f"definition: makes {len(whole)} bytes, the binary has {len(binary)}"
    for item in definition.items:
        span = slice(offset, offset + item.bits // 8)
        if whole[span] != binary[span]:
            yield (
                f"definition: default of {item.name} is {item.default!r}, the binary has "
                f"0x{binary[span].hex()}"
            )
        offset = span.stop


def _described(item: Item) -> tuple[Any, ...]:
    return (item.name, item.bits, item.kind, item.lowest, item.highest)


def _expected(place: Place) -> tuple[Any, ...]:
    member = place.field
    limits = tuple(_limit(member, side) for side in ("minimum", "maximum"))
    return (place.label.upper(), 8 * place.size, _KINDS[member.word[0]], *limits)


def _limit(member: TableField, side: str) -> float | int | None:
    if member.constant is not None:
        return member.constant
    limit: float | None = getattr(member, side)
    if limit is None or member.is_float:
        return limit
    bits, step = member.fraction_bits, member.scale
    counts = Fraction(limit) * 2**bits if bits is not None else Fraction(limit)
    if step is not None:
        counts /= Fraction(str(step))
    return ceil(counts) if side == "minimum" else floor(counts)


def _yamcs(
    section: YamcsSection, files: Mapping[str, bytes], calibration: Calibration, target: Target
) -> ReadBack:
    stack = read_stack(files[section.file])
    problems: list[str] = []
    numbers: list[Reading] = []
    if len(stack) != len(section.commands):
        problems.append(f"stack: {len(stack)} commands, not {len(section.commands)}")
    for found, declared in zip(stack, section.commands, strict=False):
        constant = list(declared.arguments.items())
        facts = {"name": declared.name, "acknowledgment": declared.acknowledgment,
                 "wait_ms": declared.wait_ms, "arguments": constant}  # fmt: skip
        said = {key: getattr(found, key) for key in facts}
        said["arguments"] = found.arguments[: len(constant)]
        problems += _facts(declared.name, said, facts)
        if declared.calibration:
            numbers = _argument_numbers(found, len(constant), declared.argument, target)
            what = f"{calibration.sensor_id} serial {calibration.serial}, instance "
            if not (found.comment or "").startswith(what + section.instance):
                problems.append(f"{found.name}: comment is {found.comment!r}")
        elif len(found.arguments) != len(constant) or found.comment != declared.comment:
            problems.append(f"{found.name}: other arguments or comment than the target declares")
    return ReadBack(numbers, problems=problems)


def _argument_numbers(
    command: StackedCommand, first: int, argument: str | None, target: Target
) -> list[Reading]:
    """Return the numbers of the arguments, or of the one argument, that carry the calibration."""
    where, arguments = places(target)[0], command.arguments[first:]
    if argument is not None:
        if len(arguments) != 1 or arguments[0][0] != argument:
            raise DecodeError(f"{command.name}: {argument} is not its one argument")
        arguments = list(_flattened(arguments[0][1], where))
    names = [name for name, _ in arguments]
    if names != [place.label for place in where]:
        raise DecodeError(f"{command.name}: arguments are {', '.join(map(str, names))}")
    numbers = [number_of_argument(value) for _, value in arguments]
    return [reading(p, word_of(p, n)) for p, n in zip(where, numbers, strict=True)]


def _flattened(members: Any, where: list[Place]) -> Iterator[tuple[str, Any]]:
    """Yield the numbers of an aggregate, by the labels that their places have."""
    if not isinstance(members, dict):
        raise DecodeError(f"Yamcs command stack: {members!r} is no aggregate")
    for name, value in members.items():
        labels = [p.label for p in where if p.field.name == name]
        if isinstance(value, list) and len(value) == len(labels):
            yield from zip(labels, value, strict=True)
        else:
            yield name, value


def _facts(what: str, found: Mapping[str, Any], expected: Mapping[str, Any]) -> Iterator[str]:
    for key, value in expected.items():
        if found[key] != value:
            yield f"{what}: {key} is {found[key]!r}, should be {value!r}"


_Reader = Callable[[Any, Mapping[str, bytes], Calibration, Target], ReadBack]
_READERS: dict[str, _Reader] = {
    "cfe": _cfe,
    "fprime": _fprime,
    "openc3": _openc3,
    "yamcs": _yamcs,
}
