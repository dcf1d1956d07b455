"""What the study ``enright`` rests on: its settings, and what the gates say of its fits."""

from __future__ import annotations

from collections.abc import Sequence

from stcal.report.content import Table, origin
from stcal.report.document import Document, section, sections, text
from stcal.report.enright_document import METHODS, sensor_name, sensors_of
from stcal.report.format import NOT_AVAILABLE, count, significant, words
from stcal.units import unit_of

_KINDS = {
    "full": "",
    "reduced": ", f, m0 and n0 only",
    "restarted": ", started from the batch calibration",
}


def gate_table(document: Document) -> Table:
    """Fits that a gate would refuse, with the reasons."""
    gates = [(s, item) for s in sensors_of(document) for item in sections(s.get("gates"))]
    rows = [
        (sensor_name(sensor), f"{METHODS.get(text(item.get('method')), '?')}"
         f"{_KINDS.get(text(item.get('fit')), '')}", _reasons(item))
        for sensor, item in gates
        if item.get("accepted") is not True
    ]  # fmt: skip
    note = (
        f"Refused {len(rows)} of {len(gates)} fits. The study evaluates a refused camera all the "
        "same; in service it would not reach an upload file. The filters run without the watch "
        "that falls back to the initial calibration, since the paper's have none."
    )
    header = ("Sensor", "Fit", "Why a gate refuses it")
    none = (("none", "", "every gate lets every fit pass"),)
    return Table("Gates", header, tuple(rows) or none, note, numeric=False)


def _reasons(item: Document) -> str:
    found = item.get("reasons")
    return "; ".join(filter(None, map(text, found))) if isinstance(found, list) else NOT_AVAILABLE


def settings_table(document: Document) -> Table:
    """What the numbers depend on."""
    sensors = sensors_of(document)
    settings = [section(sensor, "settings") for sensor in sensors]
    noise = sorted({text(s.get("simulated_noise_sd_px")) for s in settings})
    rows = (
        ("Sensors", words(document.get("sensor_id"))),
        ("Seed of the simulation", count(document.get("seed"))),
        ("Frames, calibration", _each(settings, "calibration_frames")),
        ("Frames, validation", _each(settings, "validation_frames")),
        ("Centroid noise, simulated", f"{', '.join(noise)} px"),
        ("Centroid noise, assumed", f"{_each(settings, 'noise_sd_px')} px"),
        ("Filter", "square-root EKF (sqrf)"),
        ("Initial sd of each parameter", f"{_each(settings, 'initial_sd_sigma')} sigma"),
        ("Process noise (Q, No-Refit)", _process_noise(settings)),
        *origin(document),
    )
    return Table("The study", ("", ""), rows, numeric=False)


def _each(settings: Sequence[Document], key: str) -> str:
    found = sorted({significant(item.get(key), 6) for item in settings})
    return ", ".join(found) or NOT_AVAILABLE


def _process_noise(settings: Sequence[Document]) -> str:
    """Return the random walk, once where all parameters share it."""
    found = {
        f"{unit_of(name).symbol} {significant(value, 3)}": significant(value, 3)
        for item in settings
        for name, value in section(item, "process_noise").items()
    }
    values = set(found.values())
    listed = values.pop() if len(values) == 1 else ", ".join(sorted(found))
    return f"{listed} sigma per square root of an hour" if listed else NOT_AVAILABLE
