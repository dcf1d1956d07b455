"""The scenario of a simulation: its sections together, and what must hold across them."""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field, ValidationError, model_validator

from stcal.cameras import CAMERAS, Camera
from stcal.config import SensorConfig
from stcal.simulate.drift import extremes, parameters_at
from stcal.simulate.sections import (
    CameraTruth,
    Detection,
    Drift,
    Intensity,
    Mounting,
    OrbitSection,
    Part,
    Section,
    TelemetrySection,
    TrueNoise,
    Visibility,
)
from stcal.simulate.true_camera import cameras_of, is_one_to_one
from stcal.times import parse_utc

SCHEMA = "stcal.scenario/1"
PARTS = ("calibration", "validation")

# The Earth's ephemeris ends with the year 2099.
END_TAI_NS = parse_utc("2100-01-01T00:00:00Z")

AnySection = TypeVar("AnySection", bound=Section)


class Scenario(Section):
    """One sensor in orbit; ``sensor`` is the loaded sensor configuration."""

    schema_: Literal["stcal.scenario/1"] = Field(alias="schema", default="stcal.scenario/1")
    sensor_id: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
    sensor: SensorConfig
    epoch: str
    orbit: OrbitSection
    mounting: Mounting
    camera: CameraTruth = CameraTruth()
    calibration: Part
    validation: Part
    detection: Detection
    noise: TrueNoise
    intensity: Intensity = Intensity()
    visibility: Visibility = Visibility()
    telemetry: TelemetrySection = TelemetrySection()

    @property
    def epoch_tai_ns(self) -> int:
        """The epoch as TAI ns."""
        return parse_utc(self.epoch)

    def part(self, name: str) -> Part:
        """Return the part by its name in PARTS."""
        return {"calibration": self.calibration, "validation": self.validation}[name]

    @model_validator(mode="after")
    def _consistent(self) -> Scenario:
        document = dict(self) | {"camera": self.camera.model_dump()}
        problems = cross_problems(document, self.sensor) or self._late_parts()
        if problems:
            raise ValueError("; ".join(problems))
        return self

    def _late_parts(self) -> list[str]:
        available_s = (END_TAI_NS - self.epoch_tai_ns) * 1e-9
        return [
            f"{name}: its last frame, {self.part(name).last_s:g} s after the epoch, does not lie "
            "before the year 2100"
            for name in PARTS
            if self.part(name).last_s >= available_s
        ]


def cross_problems(document: dict[str, Any], sensor: SensorConfig) -> list[str]:
    """Return what is wrong between the scenario's document and the sensor's configuration."""
    problems: list[str] = []
    sensor_id = document.get("sensor_id")
    if isinstance(sensor_id, str) and not sensor.applies_to(sensor_id):
        problems.append(f"sensor_id: {sensor_id!r} is none of the sensor's {sensor.sensor_ids}")
    epoch = document.get("epoch")
    if isinstance(epoch, str):
        try:
            parse_utc(epoch)
        except ValueError as error:
            problems.append(f"epoch: {error}")
    unknown = _unknown_parameters(document.get("camera"), sensor)
    return problems + (unknown or _camera_problems(document, sensor))


def _unknown_parameters(camera: Any, sensor: SensorConfig) -> list[str]:
    """Return what the tables of parameters name that the camera model doesn't have."""
    tables = [(f"camera.{key}", _entry(camera, key)) for key in ("initial", "offset_sigma")]
    drift = _entry(camera, "drift")
    tables += [(f"camera.drift.{key}", _entry(drift, key)) for key in ("per_kelvin", "per_day")]
    steps = _entry(drift, "steps")
    for index, step in enumerate(steps if isinstance(steps, list | tuple) else ()):
        table = _entry(step, "offset_sigma")
        tables.append((f"camera.drift.steps.{index}.offset_sigma", table))
    return [
        f"{place}.{name}: not a parameter of {sensor.camera.model}"
        for place, table in tables
        if isinstance(table, dict)
        for name in table
        if name not in CAMERAS[sensor.camera.model].parameter_names
    ]


def _entry(table: Any, key: str) -> Any:
    """Return an entry of what may not be a table: pydantic tells of that."""
    return table.get(key) if isinstance(table, dict) else None


def _camera_problems(document: dict[str, Any], sensor: SensorConfig) -> list[str]:
    truth = _valid(CameraTruth, document.get("camera", {}))
    if truth is None:
        return []
    cameras = cameras_of(truth.initial, truth.offset_sigma, sensor)
    problems = [
        f"camera: the {name} camera's map is not one-to-one over the detector"
        for name, camera in zip(("initial", "true"), cameras, strict=True)
        if not is_one_to_one(camera)
    ]
    telemetry = _valid(TelemetrySection, document.get("telemetry", {}))
    if problems or telemetry is None or truth.drift == Drift():
        return problems
    parts = (_valid(Part, document.get(name)) for name in PARTS)
    last_s = max((part.last_s for part in parts if part is not None), default=0.0)
    return _drift_problems(cameras[1], truth.drift, sensor, telemetry, last_s)


def _drift_problems(
    true: Camera, drift: Drift, sensor: SensorConfig, telemetry: TelemetrySection, last_s: float
) -> list[str]:
    """Return the first state of the drifting camera in which it would fold its map."""
    t_s, warmth = extremes(drift, telemetry.temperature_swing_c, last_s)
    parameters = parameters_at(true, drift, sensor, t_s, warmth)
    for row, seconds, kelvin in zip(parameters, t_s, warmth, strict=True):
        if not is_one_to_one(true.with_parameters(row)):
            return [
                "camera.drift: the true camera's map is not one-to-one over the detector "
                f"{seconds:g} s after the epoch at {telemetry.temperature_c + kelvin:g} deg C"
            ]
    return []


def _valid(section: type[AnySection], table: Any) -> AnySection | None:
    """Return a section by itself, None where it is wrong: pydantic tells of that."""
    try:
        return section.model_validate(table)
    except ValidationError:
        return None
