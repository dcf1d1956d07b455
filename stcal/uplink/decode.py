"""Independent decoders of the upload: what the other end would read.

They share no code with the encoders or with ``stcal.calibration``: a mistake there must show as a
difference here.  ``differences`` compares bit by bit.
"""

from __future__ import annotations

import csv
import io
import json
import struct
from dataclasses import dataclass, field
from typing import Any

PER_TABLE = ("sensor_id", "serial", "model", "rows", "cols")
_COLUMNS = ["name", "value", "unit", "sd", "parent_value", "change", "change_sd"]


class DecodeError(ValueError):
    """The bytes are not a calibration file or a parameter table."""


@dataclass(frozen=True)
class Decoded:
    """What a file says, by plain names.

    Attributes
    ----------
    texts : sensor_id, serial, model, rows, cols as text
    values : ``pixel_size_m``, every parameter, ``c_sd_11`` ... ``c_sd_33``
    covariance : (row parameter, column parameter) -> element
    sds, parents, changes, relatives : sd, parent_value, change and change_sd by name, of the
        table only
    """

    texts: dict[str, str]
    values: dict[str, float]
    covariance: dict[tuple[str, str], float] = field(default_factory=dict)
    sds: dict[str, float] = field(default_factory=dict)
    parents: dict[str, float] = field(default_factory=dict)
    changes: dict[str, float] = field(default_factory=dict)
    relatives: dict[str, float] = field(default_factory=dict)


def decode_calibration(content: bytes) -> Decoded:
    """Decode a calibration file.

    Raises
    ------
    DecodeError
        When the bytes are not a calibration file.
    """
    try:
        document = json.loads(content)
        camera = document["camera"]
        values = {"pixel_size_m": float(camera["pixel_size_m"])}
        values |= {name: float(value) for name, value in camera["parameters"].items()}
        values |= {
            f"c_sd_{i}{j}": float(element)
            for i, row in enumerate(document["c_sd"], start=1)
            for j, element in enumerate(row, start=1)
        }
        texts = {key: str(document[key]) for key in ("sensor_id", "serial")}
        texts |= {key: str(camera[key]) for key in ("model", "rows", "cols")}
        return Decoded(texts, values, _covariance(document.get("covariance")))
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise DecodeError(f"calibration file cannot be decoded: {error!r}") from None


def decode_table(content: bytes) -> Decoded:
    """Decode a parameter table.

    Raises
    ------
    DecodeError
        When the bytes are not a parameter table.
    """
    result = Decoded({}, {})
    try:
        reader = csv.reader(io.StringIO(content.decode("utf-8"), newline=""), strict=True)
        if next(reader) != _COLUMNS:
            raise ValueError("other columns")
        for name, value, _, sd, parent, change, relative in reader:
            if name in result.texts or name in result.values:
                raise ValueError(f"{name} occurs twice")
            if name in PER_TABLE:
                result.texts[name] = value
                continue
            result.values[name] = float(value)
            result.parents[name] = float(parent)
            result.changes[name] = float(change)
            if sd:
                result.sds[name] = float(sd)
            if relative:
                result.relatives[name] = float(relative)
    except (StopIteration, ValueError, csv.Error) as error:
        raise DecodeError(f"parameter table cannot be decoded: {error!r}") from None
    return result


def differences(what: str, found: dict[Any, Any], expected: dict[Any, Any]) -> list[str]:
    """Return one line for every key whose value is missing, extra, or differs in any bit."""
    lines = []
    for key in sorted(set(found) | set(expected), key=str):
        if key not in found or key not in expected:
            lines.append(f"{what} {key}: {'missing' if key not in found else 'not expected'}")
        elif _bits(found[key]) != _bits(expected[key]):
            lines.append(f"{what} {key}: decoded {found[key]!r}, should be {expected[key]!r}")
    return lines


def _bits(value: Any) -> bytes:
    return struct.pack("<d", value) if isinstance(value, float) else str(value).encode()


def _covariance(section: Any) -> dict[tuple[str, str], float]:
    if section is None:
        return {}
    names = section["parameters"]
    return {
        (a, b): float(element)
        for a, row in zip(names, section["matrix"], strict=True)
        for b, element in zip(names, row, strict=True)
    }
