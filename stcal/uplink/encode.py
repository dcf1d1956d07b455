"""Encoders of the upload: the canonical calibration file and the flat parameter table.

Every float is written with ``repr``, the shortest decimal that reads back to the same bits.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator

import numpy as np

from stcal.calibration import Calibration, file_text
from stcal.units import unit_of

CALIBRATION_FILE = "calibration.json"
TABLE_FILE = "parameters.csv"
TABLE_HEADER = ("name", "value", "unit", "sd", "parent_value", "change", "change_sd")


def encode_calibration(calibration: Calibration) -> bytes:
    """Return the calibration file of formats.md, canonical."""
    return file_text(calibration).encode("utf-8")


def encode_table(calibration: Calibration, parent: Calibration) -> bytes:
    """Return the parameter table as CSV, one line a value.

    Columns: name; value and parent_value in ``unit`` (SI or pixels); sd, one sigma of the fit;
    change = value - parent_value; change_sd = change / sd.  Empty where there is no number.
    """
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(TABLE_HEADER)
    writer.writerows(_rows(calibration, parent))
    return stream.getvalue().encode("utf-8")


def standard_deviations(calibration: Calibration) -> list[float | None]:
    """Return the sd of each parameter in its own unit, None without a covariance."""
    if calibration.covariance is None:
        return [None] * len(calibration.camera.parameter_names)
    return [math.sqrt(v) if v >= 0.0 else math.nan for v in np.diag(calibration.covariance)]


def _rows(calibration: Calibration, parent: Calibration) -> Iterator[tuple[str, ...]]:
    new, old = calibration.camera, parent.camera
    yield _plain("sensor_id", calibration.sensor_id, parent.sensor_id)
    yield _plain("serial", calibration.serial, parent.serial)
    yield _plain("model", new.model.name, old.model.name)
    yield _plain("rows", new.rows, old.rows)
    yield _plain("cols", new.cols, old.cols)
    yield _number("pixel_size_m", new.pixel_size_m, "m", None, old.pixel_size_m)
    sds = standard_deviations(calibration)
    for name, value, sd in zip(new.parameter_names, new.parameters, sds, strict=True):
        yield _number(name, float(value), unit_of(name).si, sd, old.value(name))
    for i in range(3):
        for j in range(3):
            element = float(calibration.c_sd[i, j])
            yield _number(f"c_sd_{i + 1}{j + 1}", element, "1", None, float(parent.c_sd[i, j]))


def _plain(name: str, value: object, parent_value: object) -> tuple[str, ...]:
    return (name, str(value), "", "", str(parent_value), "", "")


def _number(
    name: str, value: float, unit: str, sd: float | None, parent_value: float
) -> tuple[str, ...]:
    change = value - parent_value
    relative = repr(change / sd) if sd else ""
    return (
        name,
        repr(value),
        unit,
        "" if sd is None else repr(sd),
        repr(parent_value),
        repr(change),
        relative,
    )
