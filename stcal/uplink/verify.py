"""Compare what a spacecraft reports of a table with the one that was built."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from stcal.calibration import Calibration
from stcal.errors import InputError
from stcal.uplink.crc import crc16_arc, shown
from stcal.uplink.decode import DecodeError
from stcal.uplink.formats.read_cfe import MAGIC, TableImage, read_image
from stcal.uplink.formats.read_fprime import read_parameter
from stcal.uplink.formats.read_words import Place, by_meaning, number_of, places, read_numbers
from stcal.uplink.quantisation import held_calibration
from stcal.uplink.target import Target

# Departure from an orthonormal matrix that the coarsest words leave.
_ROTATION = 1e-3
# A dump has a time and a description of its own.
_OF_THE_DUMP = ("seconds", "subseconds", "description")


@dataclass(frozen=True)
class Difference:
    """One field that is not on board as it was built.

    ``field`` names it (``alignment_12``, ``cFE header: table name``, ``padding``);
    ``offset`` is the byte in the structure (or None); ``built`` and ``found`` are both values, for
    people.
    """

    field: str
    offset: int | None
    built: str
    found: str


@dataclass(frozen=True)
class _Content:
    """The structure of a file or dump, whether F Prime's packed form, and the cFE's headers."""

    payload: bytes
    packed: bool = False
    image: TableImage | None = None


def verify_dump(dump: bytes, built: bytes, target: Target) -> list[Difference]:
    """Return the differences of a memory dump from a built file, in order, empty when it is equal.

    Parameters
    ----------
    dump : the structure's bytes, a cFE table file dumped by table services (recognised by its
        header, whose time and description may differ), or an F Prime parameter file
    built : content of a file that was built: ``.tbl``, ``.dat`` or the OpenC3 binary; for an F
        Prime dump, the ``.dat``

    Raises
    ------
    InputError
        When the dump is a damaged file, or of another form than what was built.
    """
    ours, theirs = _content(built, target, "built file"), _content(dump, target, "dump")
    if theirs.packed and not ours.packed:
        raise InputError("the dump is an F Prime parameter file: compare it with the built .dat")
    result = list(_header_differences(ours, theirs))
    packed = ours.packed
    where, size = places(target, packed)
    for place in where:
        result += _number_difference(place, ours, theirs, target)
    result += _padding_differences(where, size, ours.payload, theirs.payload)
    result.sort(key=lambda d: -1 if d.offset is None else d.offset)
    if len(theirs.payload) != len(ours.payload):
        lengths = f"{len(ours.payload)} bytes", f"{len(theirs.payload)} bytes"
        result.append(Difference("length", None, *lengths))
    return result


def verify_crc(reported: int, built: bytes, target: Target) -> list[Difference]:
    """Return the difference of a reported CRC-16/ARC of the structure, empty when it is equal."""
    expected = crc16_arc(_content(built, target, "built file").payload)
    if reported == expected:
        return []
    return [Difference("CRC-16/ARC", None, shown(expected), shown(reported))]


def calibration_from_dump(dump: bytes, target: Target, like: Calibration) -> Calibration:
    """Return the calibration that a readback dump holds, without covariance or provenance.

    ``like`` gives what the structure does not say (sensor_id, camera model, detector).

    Raises
    ------
    InputError
        When the dump cannot be decoded or is no calibration, or the target computes with another
        camera model.
    """
    if like.camera.model.name != target.model:
        raise InputError(
            f"the target computes with {target.model!r}, not {like.camera.model.name!r}"
        )
    content = _content(dump, target, "dump")
    try:
        numbers = read_numbers(content.payload, target, content.packed, clean=False)
    except DecodeError as error:
        raise InputError(f"dump: {error}") from None
    for r in numbers:
        if r.place.meaning == "constant" and r.number != r.place.field.constant:
            raise InputError(
                f"dump: {r.place.label} is {r.number}, the target's is {r.place.field.constant}"
            )
    held = held_calibration(by_meaning(numbers), like)
    departs = float(np.abs(held.c_sd @ held.c_sd.T - np.eye(3)).max())
    if not (departs < _ROTATION and np.linalg.det(held.c_sd) > 0.0):
        raise InputError(f"dump: the alignment is no rotation (orthonormal to {departs:.2g})")
    if not held.camera.value("f_m") > 0.0:
        raise InputError(f"dump: the focal length is {held.camera.value('f_m'):g} m")
    return held


def _content(content: bytes, target: Target, what: str) -> _Content:
    """Tell a table image, an F Prime file and the bare structure apart."""
    try:
        if content.startswith(MAGIC):
            image = read_image(content)
            return _Content(image.payload, image=image)
        if target.fprime is not None and _is_parameter_file(content, target):
            parameter = read_parameter(content, target.fprime.crc_prefix)
            if parameter.identifier != target.fprime.parameter_id:
                raise DecodeError(f"F Prime file: parameter id is {parameter.identifier:#x}")
            return _Content(parameter.value, packed=True)
    except DecodeError as error:
        raise InputError(f"{what}: {error}") from None
    if not content:
        raise InputError(f"{what}: is empty")
    return _Content(content)


def _is_parameter_file(content: bytes, target: Target) -> bool:
    """Whether it begins as a record with as many bytes as follow."""
    start = 4 if target.fprime is not None and target.fprime.crc_prefix else 0
    size = int.from_bytes(content[start + 1 : start + 5], "big")
    return content[start : start + 1] == b"\xa5" and size == len(content) - start - 5


def _header_differences(ours: _Content, theirs: _Content) -> Iterator[Difference]:
    if ours.image is None or theirs.image is None:
        return
    for name, value in ours.image.header.items():
        found = theirs.image.header[name]
        if name not in (*_OF_THE_DUMP, "bytes") and found != value:
            yield Difference(f"cFE header: {name}", None, str(value), str(found))


def _number_difference(
    place: Place, ours: _Content, theirs: _Content, target: Target
) -> Iterator[Difference]:
    span = slice(place.offset, place.offset + place.size)
    built, found = ours.payload[span], theirs.payload[span]
    if built == found or len(found) < place.size:  # a short dump differs in its length
        return
    big = ours.packed or target.table.byte_order == "big"
    texts = [_shown(place, w if big else w[::-1]) for w in (built, found)]
    yield Difference(place.label, place.offset, *texts)


def _shown(place: Place, word: bytes) -> str:
    """Return a number as the target holds it, with its bytes: the flipped bit may be its last."""
    return f"{number_of(place.field, word)!r} (0x{word.hex()})"


def _padding_differences(
    where: list[Place], size: int, built: bytes, found: bytes
) -> Iterator[Difference]:
    used = {k for p in where for k in range(p.offset, p.offset + p.size)}
    for k in range(min(size, len(built), len(found))):
        if k not in used and built[k] != found[k]:
            yield Difference("padding", k, f"0x{built[k]:02x}", f"0x{found[k]:02x}")
