"""Reading report documents: any list may be empty, any number null, any key missing.

A value of another type than expected counts as not available: a report can always be made.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.errors import InputError
from stcal.reading import read_json_object

FIT_SCHEMA = "stcal.fit/1"
VALIDATION_SCHEMA = "stcal.validation/1"
ALIGNMENT_SCHEMA = "stcal.alignment/1"
FLEET_SCHEMA = "stcal.fleet/1"
CONVERSION_SCHEMA = "stcal.conversion/1"
ENRIGHT_SCHEMA = "stcal.study.enright/1"
TRACKING_SCHEMA = "stcal.study.tracking/1"
ESTIMATORS_SCHEMA = "stcal.study.estimators/1"
WU_SCHEMA = "stcal.study.wu/1"
ZHANG_SCHEMA = "stcal.study.zhang/1"

Document = Mapping[str, Any]
Floats = NDArray[np.float64]

_LARGEST, _SMALLEST = 1e12, 1e-100


def read_document(path: Path, schemas: tuple[str, ...]) -> dict[str, Any]:
    """Read a JSON document of one of the named schemas.

    Raises
    ------
    InputError
        Naming the file: unreadable, not JSON, not an object, or of another schema.
    """
    document = read_json_object(path)
    if document.get("schema") not in schemas:
        expected = " or ".join(map(repr, schemas))
        raise InputError(f"{path}: schema is {document.get('schema')!r}, expected {expected}")
    return document


def number(value: Any) -> float | None:
    """Return a finite number, or None."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        result = float(value)
    except OverflowError:
        return None
    return result if math.isfinite(result) else None


def numbers(value: Any) -> Floats:
    """Return (N,) numbers of a list, NaN where one is not available.

    What no picture can show counts as not available when large, as zero when small: sums, squares
    and quotients of the rest do not overflow.
    """
    items = [number(item) for item in sequence(value)]
    found = np.array([math.nan if item is None else item for item in items], dtype=np.float64)
    found[np.abs(found) > _LARGEST] = math.nan
    found[np.abs(found) < _SMALLEST] = 0.0
    return found


def matrix(value: Any, columns: int) -> Floats | None:
    """Return (N, columns) finite numbers of a list of lists, or None."""
    rows = [numbers(row) for row in sequence(value)]
    if not rows or any(len(row) != columns for row in rows):
        return None
    result = np.stack(rows)
    return result if np.isfinite(result).all() else None


def flags(value: Any) -> NDArray[np.bool_]:
    """Return (N,) booleans of a list."""
    return np.array([item is True for item in sequence(value)], dtype=np.bool_)


def text(value: Any) -> str:
    """Return printable text (control characters replaced), empty when there is none."""
    if value is None or isinstance(value, dict | list):
        return ""
    return "".join(c if c.isprintable() else "\ufffd" for c in " ".join(str(value).split()))


def section(document: Any, *keys: str) -> Document:
    """Return the object at a path of keys, empty when it is missing."""
    for key in keys:
        document = document.get(key) if isinstance(document, Mapping) else None
    return document if isinstance(document, Mapping) else {}


def sequence(value: Any) -> list[Any]:
    """Return the list, empty when it is missing."""
    return list(value) if isinstance(value, list | tuple) else []


def sections(value: Any) -> list[Document]:
    """Return the objects of a list."""
    return [item for item in sequence(value) if isinstance(item, Mapping)]


def columns(group: Document, *names: str) -> tuple[Floats, ...] | None:
    """Return equally long columns (N,) of a section, or None without them or without a row."""
    found = tuple(numbers(group.get(name)) for name in names)
    lengths = {len(column) for column in found}
    return found if len(lengths) == 1 and lengths != {0} else None
