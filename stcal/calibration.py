"""The calibration file, schema ``stcal.calibration/1``: reading, checking, writing."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.atomic import write_text
from stcal.cameras import CAMERAS, Camera
from stcal.errors import InputError
from stcal.reading import document_sha256, read_json_object

SCHEMA = "stcal.calibration/1"
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Calibration:
    """A sensor's camera and alignment.

    Attributes
    ----------
    sensor_id, serial : the sensor's name; the upload serial, which rises by one with each fit
    camera : the camera model with its parameter values
    c_sd : (3, 3) rotation from detector frame D to sensor frame S
    covariance : (P, P) of the camera parameters in their own units, or None
    provenance, quality : free-form JSON objects of a fitted file
    origin : the file that it was read from, for messages
    """

    sensor_id: str
    serial: int
    camera: Camera
    c_sd: Floats
    covariance: Floats | None = None
    provenance: dict[str, Any] = field(default_factory=dict)
    quality: dict[str, Any] = field(default_factory=dict)
    origin: str = field(default="", compare=False)

    def to_json(self) -> dict[str, Any]:
        """Return the JSON object of the file."""
        camera = self.camera
        document: dict[str, Any] = {
            "schema": SCHEMA,
            "sensor_id": self.sensor_id,
            "serial": self.serial,
            "camera": {
                "model": camera.model.name,
                "rows": camera.rows,
                "cols": camera.cols,
                "pixel_size_m": camera.pixel_size_m,
                "parameters": dict(
                    zip(camera.parameter_names, map(float, camera.parameters), strict=True)
                ),
            },
            "c_sd": self.c_sd.tolist(),
        }
        if self.covariance is not None:
            document["covariance"] = {
                "parameters": list(camera.parameter_names),
                "matrix": self.covariance.tolist(),
            }
        if self.provenance:
            document["provenance"] = self.provenance
        if self.quality:
            document["quality"] = self.quality
        return document


def save(calibration: Calibration, path: Path) -> None:
    """Write the calibration file atomically."""
    write_text(path, file_text(calibration))


def file_text(calibration: Calibration) -> str:
    """Return the content of the calibration file.

    A fitted one carries the hash of its content: a digit that a disk or a transfer has changed is
    still JSON.  The minimal form is what people write, and has none.
    """
    document = calibration.to_json()
    if calibration.covariance is not None:
        document["sha256"] = document_sha256(document)
    return canonical_json(document)


def canonical_json(document: dict[str, Any]) -> str:
    """Return indented JSON that round-trips every float exactly and refuses NaN."""
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def sha256_of(path: Path) -> str:
    """Return the hex SHA-256 of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def load(path: Path) -> Calibration:
    """Read a calibration file; the minimal form of the schema is enough.

    A hash that the file carries must be that of its content.

    Raises
    ------
    InputError
        Naming the file and every field that is missing or wrong.
    """
    document = read_json_object(path)
    problems: list[str] = []
    if "sha256" in document and document["sha256"] != document_sha256(document):
        raise InputError(
            f"{path}: damaged: its content does not agree with its sha256; if it was changed on "
            "purpose, remove that line"
        )
    calibration = _build(document, problems)
    if calibration is None or problems:
        raise InputError(f"{path}: " + "; ".join(problems))
    return replace(calibration, origin=str(path))


def _build(document: dict[str, Any], problems: list[str]) -> Calibration | None:
    if document.get("schema") != SCHEMA:
        problems.append(f"schema is {document.get('schema')!r}, this version reads {SCHEMA!r}")
        return None
    sensor_id, serial = document.get("sensor_id"), document.get("serial")
    if not isinstance(sensor_id, str) or not sensor_id:
        problems.append("sensor_id is missing or not text")
    if isinstance(serial, bool) or not isinstance(serial, int) or not 0 <= serial < 2**31:
        problems.append(f"serial is {str(serial)[:40]}, not a whole number from 0 to 2147483647")
    camera = _camera(document.get("camera"), problems)
    c_sd = _rotation(document.get("c_sd"), problems)
    if problems or camera is None or c_sd is None:
        return None
    return Calibration(
        sensor_id=str(sensor_id),
        serial=int(serial),  # type: ignore[arg-type]
        camera=camera,
        c_sd=c_sd,
        covariance=_covariance(document.get("covariance"), camera, problems),
        provenance=_mapping(document, "provenance", problems),
        quality=_mapping(document, "quality", problems),
    )


def _mapping(document: dict[str, Any], key: str, problems: list[str]) -> dict[str, Any]:
    value = document.get(key, {})
    if not isinstance(value, dict):
        problems.append(f"{key} is not an object")
        return {}
    return value


def _camera(section: Any, problems: list[str]) -> Camera | None:
    if not isinstance(section, dict):
        problems.append("camera is missing or not an object")
        return None
    name = section.get("model")
    if not isinstance(name, str) or name not in CAMERAS:
        problems.append(f"camera.model is {name!r}, known models: {', '.join(CAMERAS)}")
        return None
    before = len(problems)
    size = {key: section.get(key) for key in ("rows", "cols")}
    for key, count in size.items():
        if isinstance(count, bool) or not isinstance(count, int) or not 2 <= count <= 100_000:
            problems.append(f"camera.{key} is {count!r}, not a pixel count")
    pixel = _number(section.get("pixel_size_m"), "camera.pixel_size_m", problems)
    if pixel is not None and pixel <= 0:
        problems.append(f"camera.pixel_size_m is {pixel}, not positive")
    values = section.get("parameters")
    names = CAMERAS[name].parameter_names
    if not isinstance(values, dict):
        problems.append("camera.parameters is missing or not an object")
        return None
    unknown = sorted(set(values) - set(names))
    if unknown:
        problems.append(f"camera.parameters has unknown names: {', '.join(unknown)}")
    numbers = [_number(values.get(p), f"camera.parameters.{p}", problems) for p in names]
    if len(problems) > before:
        return None
    camera = Camera(
        model=CAMERAS[name],
        rows=int(size["rows"]),  # type: ignore[arg-type]
        cols=int(size["cols"]),  # type: ignore[arg-type]
        pixel_size_m=float(pixel),  # type: ignore[arg-type]
        parameters=np.array(numbers, dtype=np.float64),
    )
    if camera.value("f_m") <= 0:
        problems.append(f"camera.parameters.f_m is {camera.value('f_m')}, not positive")
    elif not _sees(camera):
        problems.append("camera.parameters give no directions in front of the detector")
    else:
        return camera
    return None


def _sees(camera: Camera) -> bool:
    """Whether the detector's corners look forward, each in a direction of its own."""
    m = np.array([0.0, 0.0, camera.rows - 1.0, camera.rows - 1.0])
    n = np.array([0.0, camera.cols - 1.0, 0.0, camera.cols - 1.0])
    with np.errstate(all="ignore"):
        s_d = camera.directions(m, n)
        apart = np.abs(s_d[:, None] - s_d[None, :]).max(axis=2) + np.eye(4)
    return bool(np.isfinite(s_d).all() and (s_d[:, 2] > 0.0).all() and apart.min() > 1e-9)


def _number(value: Any, name: str, problems: list[str]) -> float | None:
    if value is None:
        problems.append(f"{name} is missing")
    elif isinstance(value, bool) or not isinstance(value, int | float):
        problems.append(f"{name} is {value!r}, not a number")
    elif not abs(value) < 1e300:
        problems.append(f"{name} is {value!r}, not finite")
    else:
        return float(value)
    return None


def _rotation(rows: Any, problems: list[str]) -> Floats | None:
    try:
        matrix = np.array(rows, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.empty(0)
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        problems.append("c_sd is not a 3 x 3 matrix of numbers")
        return None
    error = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    if error > 1e-6 or np.linalg.det(matrix) < 0:
        problems.append(f"c_sd is not a rotation (departs from orthonormal by {error:.2g})")
        return None
    return matrix


def _covariance(section: Any, camera: Camera, problems: list[str]) -> Floats | None:
    if section is None:
        return None
    names = section.get("parameters") if isinstance(section, dict) else None
    if not isinstance(names, list) or sorted(map(str, names)) != sorted(camera.parameter_names):
        problems.append("covariance.parameters does not name the camera's parameters")
        return None
    try:
        matrix = np.array(section.get("matrix"), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.empty(0)
    size = len(names)
    if matrix.shape != (size, size) or not np.isfinite(matrix).all():
        problems.append(f"covariance.matrix is not a {size} x {size} matrix of numbers")
        return None
    order = [names.index(name) for name in camera.parameter_names]
    return np.asarray(matrix[np.ix_(order, order)])
