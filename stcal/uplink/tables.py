"""Upload tables: a calibration in every format of its target, decoded again and judged.

``encode_checked`` is what a build calls: it never raises, and its reasons are those of a gate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from math import isfinite
from typing import Any

from stcal.calibration import Calibration
from stcal.uplink.crc import crc16_arc, shown
from stcal.uplink.formats import cfe, fprime, openc3, yamcs
from stcal.uplink.formats.read_words import Reading, by_meaning
from stcal.uplink.formats.words import EncodeError, number_problems
from stcal.uplink.quantisation import held_calibration, rounding_effect, rounding_refusals
from stcal.uplink.quantities import quantities
from stcal.uplink.read_back import ReadBack, read_back
from stcal.uplink.target import Target
from stcal.uplink.target_fields import si_unit

# Each is handed the target's section of its name, where the target has one.
ENCODERS: dict[str, Callable[[Any, Calibration, Target], dict[str, bytes]]] = {
    "cfe": cfe.encode,
    "fprime": fprime.encode,
    "openc3": openc3.encode,
    "yamcs": yamcs.encode,
}


@dataclass(frozen=True)
class Checked:
    """What decoding and comparing the files of one calibration found.

    Attributes
    ----------
    reasons : why they must not leave, empty when they may
    figures : for the JSON: ``rounding`` (rms_urad, worst_urad, at_row_px, at_col_px, limit_urad,
        fit_rms_urad), ``fields`` (one object a number: name, holds, value, on_target, error, unit,
        word, minimum, maximum; value and error in SI or px), ``payload_bytes`` and ``crc16_arc``
        by file (of the structure in each binary file; of the ``.tbl``, what the cFE reports)
    """

    reasons: list[str]
    figures: dict[str, Any] = field(default_factory=dict)


def encode_all(calibration: Calibration, target: Target) -> dict[str, bytes]:
    """Return file name -> content of every format that the target declares.

    Raises
    ------
    EncodeError
        With every reason (``.reasons``): NaN, infinity, a number beyond its word or its limits,
        another camera model or detector.
    """
    problems = list(_wrong_target(calibration, target))
    # Another camera model has other numbers.
    if calibration.camera.model.name == target.model:
        problems += number_problems(calibration, target)
    if problems:
        raise EncodeError(problems)
    files: dict[str, bytes] = {}
    for name, encode in ENCODERS.items():
        section = getattr(target, name)
        if section is not None:
            files |= encode(section, calibration, target)
    return files


def _wrong_target(calibration: Calibration, target: Target) -> Iterator[str]:
    sensor, camera = calibration.sensor_id, calibration.camera
    if not target.applies_to(sensor):
        yield f"sensor_id {sensor!r}: the target is for {', '.join(target.sensor_ids)}"
    if not (sensor.isascii() and sensor.isprintable()) or "<%" in sensor:
        yield f"sensor_id {sensor!r} cannot be written into the target's files"
    if camera.model.name != target.model:
        yield f"camera model is {camera.model.name!r}, the target computes with {target.model!r}"
    for name in ("rows", "cols", "pixel_size_m"):
        compiled = getattr(target.detector, name)
        if compiled is not None and compiled != getattr(camera, name):
            yield f"camera.{name} is {getattr(camera, name)!r}, the target's is {compiled!r}"


def check_all(
    files: Mapping[str, bytes], calibration: Calibration, target: Target, rms_urad: float | None
) -> Checked:
    """Decode files with the independent decoders and compare them with the calibration.

    Parameters
    ----------
    files : of :func:`encode_all`, or read from disk
    rms_urad : the fit's RMS, by which the rounding is judged (``quality.rms_urad.fitted``); for a
        parent without one, its successor's; None refuses
    """
    try:
        fresh = encode_all(calibration, target)
    except EncodeError as error:
        return Checked(error.reasons)
    return _check(files, calibration, target, rms_urad, list(_file_differences(files, fresh)))


def _check(
    files: Mapping[str, bytes],
    calibration: Calibration,
    target: Target,
    rms_urad: float | None,
    differences: Sequence[str] = (),
) -> Checked:
    """Decode and judge files, whose ``differences`` from a fresh encoding are known."""
    found = read_back(files, calibration, target)
    reasons = [line for format_ in found.values() for line in format_.problems]
    reasons += differences
    numbers = next((f.numbers for f in found.values() if f.numbers), [])
    figures = _figures(found, numbers, calibration)
    if numbers:
        held = held_calibration(by_meaning(numbers), calibration)
        effect, part = rounding_effect(calibration, held), target.rounding.maximum_part_of_rms
        reasons += rounding_refusals(effect, rms_urad, part)
        limit = None if rms_urad is None else part * rms_urad
        shown_effect = {k: v if isfinite(v) else None for k, v in asdict(effect).items()}
        figures["rounding"] = {**shown_effect, "limit_urad": limit, "fit_rms_urad": rms_urad}
    return Checked(reasons, figures)


def encode_checked(
    calibration: Calibration, target: Target, rms_urad: float | None
) -> tuple[dict[str, bytes], Checked]:
    """Encode and check in one go; without files when the calibration cannot be encoded."""
    try:
        files = encode_all(calibration, target)
    except EncodeError as error:
        return {}, Checked(error.reasons)
    return files, _check(files, calibration, target, rms_urad)


def _file_differences(files: Mapping[str, bytes], fresh: Mapping[str, bytes]) -> Iterator[str]:
    """Yield the first byte in which each file is not what is encoded now."""
    for name, content in fresh.items():
        given = files.get(name)
        if given is not None and given != content:
            pairs = enumerate(zip(given, content, strict=False))
            first = next((k for k, (a, b) in pairs if a != b), min(len(given), len(content)))
            yield f"{name}: byte {first} and on are not what is encoded of this calibration"
    yield from (f"{name}: no file of this target" for name in files if name not in fresh)


def _figures(
    found: Mapping[str, ReadBack], numbers: list[Reading], calibration: Calibration
) -> dict[str, Any]:
    payloads = {k: v for format_ in found.values() for k, v in format_.payloads.items()}
    given = quantities(calibration)
    return {
        "fields": [_field_figures(r, given) for r in numbers],
        "payload_bytes": {name: len(payload) for name, payload in payloads.items()},
        "crc16_arc": {name: shown(crc16_arc(payload)) for name, payload in payloads.items()},
    }


def _field_figures(r: Reading, numbers: Mapping[str, float | int]) -> dict[str, Any]:
    member = r.place.field
    value = numbers.get(r.place.meaning, member.constant)
    return {
        "name": r.place.label,
        "holds": r.place.meaning,
        "value": value,
        "on_target": r.number,
        "error": None if value is None else float(r.value) - value,
        "unit": member.unit or si_unit(member.value),
        "word": member.word,
        "minimum": member.minimum,
        "maximum": member.maximum,
    }
