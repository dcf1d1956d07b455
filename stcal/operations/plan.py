"""The plan of a recalibration: which sensors, from which telemetry, to which upload."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)

from stcal.config import STRICT, error_lines
from stcal.errors import ConfigError
from stcal.reading import read_toml
from stcal.times import parse_utc

SCHEMA = "stcal.recalibration/1"
# The run's own documents, and its ingest's, lie beside the folders of the sensors.
_TAKEN = ("recalibration.json", "index.html", "ingest.log", "ingest.step.json")


def _utc(text: str) -> str:
    try:
        parse_utc(text if "T" in text else f"{text}T00:00:00Z")
    except ValueError:
        raise ValueError("is not a UTC time such as 2026-01-05 or 2026-01-05T12:00:00Z") from None
    return text


def _folder_name(text: str) -> str:
    if not text.isprintable() or text in (".", "..") or set(text) & set('/\\:*?"<>|'):
        raise ValueError("cannot be the name of a folder")
    if text.lower() in _TAKEN:
        raise ValueError("is the name of a file of the results")
    return text


Utc = Annotated[str, AfterValidator(_utc)]
Text = Annotated[str, Field(min_length=1)]
FolderName = Annotated[str, Field(min_length=1, max_length=120), AfterValidator(_folder_name)]


class _Section(BaseModel):
    model_config = STRICT


class Span(_Section):
    """A time range: from, and up to but not including; open where not given."""

    start: Utc | None = Field(default=None, alias="from")
    stop: Utc | None = Field(default=None, alias="to")


class FitChoice(_Section):
    """How the camera is fitted; the options of ``stcal fit``."""

    method: Literal["batch", "ekf", "sqrf", "ukf", "smoother"] = "batch"
    options: list[Text] = []


class Override(_Section):
    """A gate of the upload whose refusal does not count, and why; the manifest keeps both."""

    gate: Text
    reason: Text


class Sensor(_Section):
    """One sensor: its calibration on board, and which frames fit and judge."""

    sensor_id: FolderName
    # The calibration that the sensor flies with, and a dump of its table if one was read back.
    onboard: Text
    readback: Text | None = None
    overrides: list[Override] = []
    fit: Span = Span()
    validate_: Span = Field(default=Span(), alias="validate")
    method: FitChoice | None = None

    @model_validator(mode="after")
    def _apart(self) -> Sensor:
        if self.fit == self.validate_:
            raise ValueError(
                "fit and validate use the same time range: a fit proves nothing on its own frames"
            )
        return self


class Plan(_Section):
    """A recalibration of one or more sensors; paths are relative to the plan's file."""

    schema_: Literal["stcal.recalibration/1"] = Field(alias="schema")
    store: Text
    out: Text
    configs: Annotated[list[Text], Field(min_length=1)]
    target: Text | None = None
    # Files, folders or patterns; none when the store is filled otherwise.
    sources: list[Text] = []
    ingest_options: list[Text] = []
    fit: FitChoice = FitChoice()
    sensors: Annotated[list[Sensor], Field(min_length=1)]

    @field_validator("store")
    @classmethod
    def _a_folder(cls, store: str) -> str:
        if "://" in store:
            raise ValueError("a plan's store is a folder, not a URL: its files tell what to redo")
        return store

    @model_validator(mode="after")
    def _each_sensor_once(self) -> Plan:
        names = [sensor.sensor_id for sensor in self.sensors]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"sensors listed more than once: {', '.join(twice)}")
        return self


@dataclass(frozen=True)
class PlanFile:
    """A plan and where it was read from: an absolute path, as workers may run elsewhere."""

    path: Path
    plan: Plan

    def resolve(self, name: str) -> Path:
        """Return an absolute path: of the plan, or relative to the plan's folder."""
        return self.path.parent / name

    @property
    def out(self) -> Path:
        """The folder of all results."""
        return self.resolve(self.plan.out)

    @property
    def store(self) -> Path:
        """The telemetry store."""
        return self.resolve(self.plan.store)

    def sources(self) -> list[Path]:
        """Return the downlink files, patterns expanded, in order.

        Raises
        ------
        ConfigError
            When a pattern or a name finds nothing.
        """
        found: list[Path] = []
        for name in self.plan.sources:
            here = self.resolve(name)
            listed = [here] if here.exists() else _matching(self.path.parent, name)
            if not listed:
                raise ConfigError(f"{self.path}: sources: {name!r} finds no file")
            found += listed
        return found


def _matching(folder: Path, pattern: str) -> list[Path]:
    base = Path(pattern)
    if base.is_absolute():
        return sorted(Path(base.anchor).glob(str(base.relative_to(base.anchor))))
    return sorted(folder.glob(pattern))


def load_plan(path: Path) -> PlanFile:
    """Read and validate a plan.

    Raises
    ------
    ConfigError
        Naming the file and every error in it.
    """
    document = read_toml(path)
    try:
        return PlanFile(path.absolute(), Plan.model_validate(document))
    except ValidationError as error:
        raise ConfigError(f"{path}:\n" + "\n".join(error_lines(error))) from None
