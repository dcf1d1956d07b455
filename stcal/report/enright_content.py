"""Tables III to VII in the report of the study ``enright``: the paper's values above ours."""

from __future__ import annotations

from typing import Any

from stcal.report.content import Table, quotient
from stcal.report.document import Document, number, section, sections, text
from stcal.report.enright_document import (
    METHODS,
    difference,
    parameter_of,
    sensor_name,
    sensors_of,
    shown_sensor,
)
from stcal.report.enright_notes import (
    change_note,
    distortion_note,
    error_note,
    matching_note,
    performance_note,
)
from stcal.report.format import NOT_AVAILABLE, fixed, measured, rms
from stcal.units import unit_of

_CAMERAS = {"raw": "Raw", **METHODS, "true": "True camera"}


def change_table(document: Document) -> Table:
    """Table III: parameter changes by batch recalibration, in sigma of Table II."""
    sensors = sensors_of(document)
    names = (
        [text(row.get("name")) for row in sections(sensors[0].get("parameters"))] if sensors else []
    )
    rows = []
    for name in names:
        found = [parameter_of(sensor, name) for sensor in sensors]
        paper = [section(s, "paper", "change_sigma").get(name) for s in sensors]
        symbol = unit_of(name).symbol
        rows.append((f"{symbol}, paper", *(fixed(v, 2, signed=True) for v in paper)))
        rows.append((f"{symbol}, stcal", *(_change(row) for row in found)))
    header = ("Change [sigma]", *(sensor_name(sensor) for sensor in sensors))
    title = "Table III. Parameter changes during batch recalibration"
    return Table(title, header, tuple(rows), change_note(sensors))


def _change(row: Document) -> str:
    sigma = number(row.get("sigma"))
    fitted, sd = section(row, "fitted").get("batch"), section(row, "sd").get("batch")
    change = difference(fitted, row.get("initial"))
    shown = fixed(quotient(change, sigma), 2, signed=True)
    spread = fixed(quotient(sd, sigma), 2)
    return shown if NOT_AVAILABLE in (shown, spread) else f"{shown} ± {spread}"


def performance_table(document: Document) -> Table:
    """Table IV: availability, matched stars and RMS on the calibration data."""
    header = ("Sensor", "Availability initial", "Availability final", "Matched star ratio",
              "RMS initial [µrad]", "RMS final [µrad]", "RMS initial, own pairs")  # fmt: skip
    rows = []
    for sensor in sensors_of(document):
        for source, label in ((section(sensor, "paper"), "paper"), (sensor, "stcal")):
            raw, batch = (section(source, "calibration", "cameras", n) for n in ("raw", "batch"))
            own = rms(raw.get("own_rms_urad")) if source is sensor else ""
            rows.append(
                (
                    f"{text(sensor.get('number'))}, {label}",
                    fixed(raw.get("availability")),
                    fixed(batch.get("availability")),
                    fixed(batch.get("matched_star_ratio")),
                    rms(raw.get("rms_urad")),
                    rms(batch.get("rms_urad")),
                    own,
                )
            )
    title = "Table IV. Batch calibration performance, calibration data"
    return Table(title, header, tuple(rows), performance_note(sensors_of(document)))


def error_table(document: Document) -> Table:
    """Table V: RMS on the validation data, over one set of pairs for each sensor."""
    rows = []
    for sensor in sensors_of(document):
        for suffix, mark in (("", ""), ("_reduced", "R")):
            for source, label in ((section(sensor, "paper"), "paper"), (sensor, "stcal")):
                cells = [_error(source, key, suffix) for key in _CAMERAS]
                if any(cell not in ("", NOT_AVAILABLE) for cell in cells[1:]):
                    name = f"{text(sensor.get('number'))}{mark}, {label}"
                    rows.append((name, *cells))
    header = ("RMS [µrad]", *_CAMERAS.values())
    title = "Table V. Estimator validation RMS"
    return Table(title, header, tuple(rows), error_note(sensors_of(document)))


def _error(source: Document, camera: str, suffix: str) -> str:
    """One cell: no method is reduced that isn't fitted; the paper's sensors have no true camera."""
    name = camera if camera in ("raw", "true") else camera + suffix
    found = section(source, "validation", "cameras")
    if camera == "true" and (suffix or "true" not in found):
        return ""
    return rms(section(found, name).get("rms_urad"))


def matching_table(document: Document) -> Table:
    """Table VI: matched stars and availability on the validation data."""
    columns = [(key, "matched_star_ratio", f"Ratio, {label}") for key, label in METHODS.items()]
    columns += [(key, "availability", f"Avail., {label}") for key, label in METHODS.items()]
    rows = []
    for sensor in sensors_of(document):
        for source, label in ((section(sensor, "paper"), "paper"), (sensor, "stcal")):
            cameras = section(source, "validation", "cameras")
            cells = [fixed(section(cameras, key).get(what)) for key, what, _ in columns]
            raw = fixed(section(cameras, "raw").get("availability")) if source is sensor else ""
            rows.append((f"{text(sensor.get('number'))}, {label}", *cells, raw))
    header = ("Sensor", *(heading for *_, heading in columns), "Avail., Raw")
    title = "Table VI. Matching and availability, validation data"
    return Table(title, header, tuple(rows), matching_note(sensors_of(document)))


def distortion_table(document: Document) -> Table:
    """Table VII: focal length and distortion of one sensor by method."""
    sensor = shown_sensor(document, "distortion")
    published = section(sensor, "paper", "distortion")
    rows = []
    for name in ("f_m", "b4_per_m4", "b2_per_m2"):
        unit, row = unit_of(name), parameter_of(sensor, name)
        if name in published:
            paper = section(published, name)
            cells = (_in_unit(paper.get(key), unit.size) for key in METHODS)
            rows.append((f"{unit.label}, paper", *(fixed(v, 3) for v in cells), ""))
        if row:
            fitted, sd = section(row, "fitted"), section(row, "sd")
            shown = [
                measured(_in_unit(fitted.get(k), unit.size), _in_unit(sd.get(k), unit.size))
                for k in METHODS
            ]
            true = measured(
                _in_unit(row.get("true"), unit.size), _in_unit(sd.get("batch"), unit.size)
            )
            rows.append((f"{unit.label}, stcal", *shown, true))
    header = ("Parameter", *METHODS.values(), "True camera")
    title = f"Table VII. Comparison of distortion parameters, {sensor_name(sensor)}"
    return Table(title, header, tuple(rows), distortion_note(sensor))


def _in_unit(value: Any, size: float) -> float | None:
    found = number(value)
    return None if found is None else found / size
