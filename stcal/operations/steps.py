"""The steps of a recalibration as commands, with the files that each reads and writes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from stcal.operations.plan import FitChoice, PlanFile, Sensor, Span
from stcal.telemetry.store import Store

CALIBRATION, FIT, VALIDATION = "calibration.json", "fit.json", "validation.json"


@dataclass(frozen=True)
class Step:
    """One command.

    Attributes
    ----------
    name : of the step
    arguments : of ``stcal``
    folder : where its record and its log go
    inputs : files that its result depends on
    outputs : files, or folders of files, that it must have written when it succeeds
    """

    name: str
    arguments: tuple[str, ...]
    folder: Path
    inputs: tuple[Path, ...]
    outputs: tuple[Path, ...]


def ingest_step(file: PlanFile) -> Step | None:
    """Return the step that fills the store, None when the plan names no sources."""
    sources = file.sources()
    if not sources:
        return None
    configs = _configs(file)
    arguments = ["ingest", *map(str, sources), "--store", str(file.store)]
    for config in configs:
        arguments += ["--config", str(config)]
    return Step(
        "ingest",
        (*arguments, *file.plan.ingest_options),
        file.out,
        (*(found for source in sources for found in _files(source)), *configs),
        (),
    )


def sensor_steps(file: PlanFile, sensor: Sensor) -> Iterator[Step]:
    """Yield the steps of one sensor, in their order; each needs the one before."""
    folder = file.out / sensor.sensor_id
    fit, validation = folder / "fit", folder / "validation"
    onboard = file.resolve(sensor.onboard)
    telemetry = (*_telemetry(file.store, sensor.sensor_id), *_configs(file))
    here = ("--store", str(file.store), "--sensor", sensor.sensor_id)
    fitted = fit / CALIBRATION
    yield Step(
        "fit",
        ("fit", *_method(sensor.method or file.plan.fit), *here, *_span(sensor.fit),
         "--initial", str(onboard), "--out", str(fit)),
        folder,
        (*telemetry, onboard),
        (fitted, fit / FIT),
    )  # fmt: skip
    yield Step(
        "validate",
        ("validate", *here, *_span(sensor.validate_), "--baseline", str(onboard),
         "--candidate", str(fitted), "--out", str(validation)),
        folder,
        (*telemetry, onboard, fitted),
        (validation / VALIDATION,),
    )  # fmt: skip
    yield _build_step(file, sensor, folder, fitted, validation / VALIDATION, telemetry)


def _build_step(
    file: PlanFile,
    sensor: Sensor,
    folder: Path,
    fitted: Path,
    validation: Path,
    telemetry: tuple[Path, ...],
) -> Step:
    onboard = file.resolve(sensor.onboard)
    arguments = ["uplink", "build", "--calibration", str(fitted), "--parent", str(onboard)]
    arguments += ["--validation", str(validation), "--out", str(folder / "uplink")]
    arguments += ["--store", str(file.store)]
    inputs = [*telemetry, onboard, fitted, validation]
    for option, name in (("--target", file.plan.target), ("--readback", sensor.readback)):
        if name is not None:
            arguments += [option, str(file.resolve(name))]
            inputs.append(file.resolve(name))
    for override in sensor.overrides:
        arguments += ["--override", override.gate, "--reason", override.reason]
    return Step("build", tuple(arguments), folder, tuple(inputs), (folder / "uplink",))


def report_arguments(folder: Path) -> tuple[str, ...]:
    """Return the command that makes one report of a sensor's fit and validation."""
    return (
        "report", str(folder / "fit" / FIT), str(folder / "validation" / VALIDATION),
        "--out", str(folder / "report.html"),
    )  # fmt: skip


def _method(choice: FitChoice) -> tuple[str, ...]:
    method = ("--batch",) if choice.method == "batch" else ("--sequential", choice.method)
    return (*method, *choice.options)


def _span(span: Span) -> tuple[str, ...]:
    given = (("--from", span.start), ("--to", span.stop))
    return tuple(part for option, value in given if value is not None for part in (option, value))


def _configs(file: PlanFile) -> tuple[Path, ...]:
    return tuple(file.resolve(name) for name in file.plan.configs)


def _telemetry(store: Path, sensor_id: str) -> tuple[Path, ...]:
    """Return the store's files of a sensor, none while there is no store."""
    return tuple(Store.open(store).files(sensor_id)) if store.exists() else ()


def _files(source: Path) -> list[Path]:
    if not source.is_dir():
        return [source]
    return sorted(path for path in source.iterdir() if path.is_file())
