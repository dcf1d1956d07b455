"""Reading the document of the study ``enright``: its sensors, parameters and cameras."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from stcal.report.document import Document, Floats, number, numbers, section, sections, text

METHODS = {"batch": "Batch", "q": "Q", "no_q": "No-Q", "no_refit": "No-Refit"}
FILTERS = {key: label for key, label in METHODS.items() if key != "batch"}


def sensors_of(document: Document) -> list[Document]:
    """Return the sensors' studies."""
    return sections(document.get("sensors"))


def shown_sensor(document: Document, what: str) -> Document:
    """Return the sensor that a figure shows: the paper's if it was run; empty without any."""
    wanted = section(document, "shown").get(what)
    return next((s for s in sensors_of(document) if s.get("number") == wanted), {})


def sensor_name(sensor: Document) -> str:
    """Return the paper's name of a sensor."""
    return f"Sensor {text(sensor.get('number')) or '?'}"


def parameter_of(sensor: Document, name: str) -> Document:
    """Return a sensor's row of a parameter, empty without it."""
    rows = sections(sensor.get("parameters"))
    return next((row for row in rows if row.get("name") == name), {})


def column(sources: Iterable[Document], part: str, camera: str, key: str) -> Floats:
    """Return a camera's number of each sensor (N,), NaN where there is none."""
    return numbers([section(source, part, "cameras", camera).get(key) for source in sources])


def difference(value: Any, other: Any) -> float | None:
    """Return value - other, or None where either is missing."""
    a, b = number(value), number(other)
    return None if a is None or b is None else a - b
