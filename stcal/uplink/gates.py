"""The gates that an upload must pass: each returns the reasons why it must not leave.

A gate never raises; ``refusals`` runs all of them, so that every reason is told at once.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from stcal.calibration import Calibration

HASHES = ("telemetry_sha256", "catalogue_sha256", "config_sha256", "parent_sha256")
_SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class Candidate:
    """What the gates look at: the new calibration, its parent, their hashes, the validation."""

    calibration: Calibration
    sha256: str
    parent: Calibration
    parent_sha256: str
    validation: Mapping[str, Any] | None


def identity(candidate: Candidate) -> Iterator[str]:
    """The same sensor, the same camera model on the same detector."""
    new, old = candidate.calibration, candidate.parent
    pairs: tuple[tuple[str, Any, Any], ...] = (
        ("sensor_id", new.sensor_id, old.sensor_id),
        ("camera.model", new.camera.model.name, old.camera.model.name),
        ("camera.rows", new.camera.rows, old.camera.rows),
        ("camera.cols", new.camera.cols, old.camera.cols),
        ("camera.pixel_size_m", new.camera.pixel_size_m, old.camera.pixel_size_m),
    )
    for name, value, parent_value in pairs:
        if value != parent_value:
            yield f"{name} is {value!r}, the parent's is {parent_value!r}"
    if not new.sensor_id.isprintable():
        yield f"sensor_id {new.sensor_id!r} has characters that cannot be printed"


def serial(candidate: Candidate) -> Iterator[str]:
    """The serial rises over the parent's."""
    new, old = candidate.calibration.serial, candidate.parent.serial
    if new <= old:
        yield f"serial {new} does not rise over the parent's {old}"


def covariance(candidate: Candidate) -> Iterator[str]:
    """A covariance is there, and says how well each changed parameter is known."""
    calibration = candidate.calibration
    if calibration.covariance is None:
        yield "covariance is missing: this is not a fitted calibration"
        return
    names = calibration.camera.parameter_names
    for name, variance in zip(names, np.diag(calibration.covariance), strict=True):
        # A parameter held fixed has no variance, and then no change either.
        held = variance == 0.0 and _unchanged(name, candidate)
        if not (variance > 0.0 or held):
            yield f"covariance: the variance of {name} is {float(variance)!r}"


def provenance(candidate: Candidate) -> Iterator[str]:
    """Every input is named by its hash, and the parent is the one it was fitted from."""
    found = candidate.calibration.provenance
    for key in HASHES:
        value = found.get(key)
        if not isinstance(value, str) or not _SHA256.fullmatch(value):
            yield f"provenance.{key} is {value!r}, not a SHA-256"
    parent = found.get("parent_sha256")
    if isinstance(parent, str) and _SHA256.fullmatch(parent) and parent != candidate.parent_sha256:
        expected = candidate.parent_sha256
        yield f"provenance.parent_sha256 is {parent}, the parent file's is {expected}"


def fit_verdict(candidate: Candidate) -> Iterator[str]:
    """The fit itself was accepted."""
    yield from _verdict("quality.verdict", candidate.calibration.quality.get("verdict"))


def validation(candidate: Candidate) -> Iterator[str]:
    """The validation, where given, was accepted and is about these two files."""
    document = candidate.validation
    if document is None:
        return
    yield from _verdict("validation verdict", document.get("verdict"))
    if document.get("sensor_id") != candidate.calibration.sensor_id:
        yield f"validation is of sensor {document.get('sensor_id')!r}"
    expected = {"candidate": candidate.sha256, "baseline": candidate.parent_sha256}
    for which, sha256 in expected.items():
        section = document.get(which)
        found = section.get("sha256") if isinstance(section, Mapping) else None
        if found != sha256:
            yield f"validation {which}.sha256 is {found!r}, the file's is {sha256!r}"


GATES: dict[str, Callable[[Candidate], Iterator[str]]] = {
    "identity": identity,
    "serial": serial,
    "covariance": covariance,
    "provenance": provenance,
    "fit verdict": fit_verdict,
    "validation": validation,
}


def refusals(candidate: Candidate) -> list[str]:
    """Return the reasons of all gates, empty when the upload may leave."""
    return [reason for gate in GATES.values() for reason in gate(candidate)]


def not_finite(document: Any, place: str = "") -> Iterator[str]:
    """Name every number of a JSON document that is NaN or infinite."""
    if isinstance(document, float) and not math.isfinite(document):
        yield f"{place or 'file'} is {document!r}"
    elif isinstance(document, dict):
        for key, value in document.items():
            yield from not_finite(value, f"{place}.{key}" if place else str(key))
    elif isinstance(document, list):
        for index, value in enumerate(document):
            yield from not_finite(value, f"{place}[{index}]")


def _verdict(name: str, found: Any) -> Iterator[str]:
    if not isinstance(found, Mapping):
        yield f"{name} is missing"
    elif found.get("accepted") is not True:
        reasons = found.get("reasons")
        listed = "; ".join(map(str, reasons)) if isinstance(reasons, list) else ""
        yield f"{name} is not accepted" + (f": {listed}" if listed else "")


def _unchanged(name: str, candidate: Candidate) -> bool:
    old = candidate.parent.camera
    if name not in old.parameter_names:
        return False
    return candidate.calibration.camera.value(name) == old.value(name)
