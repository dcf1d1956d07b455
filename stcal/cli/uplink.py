"""``stcal uplink``: build an upload, approve it, verify what flies, compare two calibrations."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stcal.cli.inputs import JSON, StorePlace
from stcal.cli.output import emit
from stcal.errors import InputError, UsageError

if TYPE_CHECKING:
    from rich.console import Console

    from stcal.config import SensorConfig
    from stcal.telemetry.places import Place
    from stcal.uplink.build import Built
    from stcal.uplink.verify import Difference

_FILE = click.Path(path_type=Path, dir_okay=False)
_FOLDER = click.Path(path_type=Path, file_okay=False)


@click.group(name="uplink")
def command() -> None:
    """Build, approve, verify and compare calibration uploads."""


@command.command()
@click.option("--calibration", required=True, type=_FILE, help="The fitted calibration file.")
@click.option("--parent", required=True, type=_FILE, help="The calibration file on board.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Uploads' folder.")
@click.option("--validation", type=_FILE, help="validation.json of these two calibrations.")
@click.option("--store", type=StorePlace(), help="Store that the calibration was fitted from.")
@click.option("--config", type=_FILE, help="Sensor configuration; the store's if not given.")
@click.option("--target", "target_path", type=_FILE, help="How the flight software holds it.")
@click.option("--readback", type=_FILE, help="Dump of the table on board, to compare the parent.")
@click.option("--override", multiple=True, help="Gate whose refusal does not count.")
@click.option("--reason", multiple=True, help="Why: one for each --override, in its order.")
@JSON
def build(
    calibration: Path,
    parent: Path,
    out: Path,
    validation: Path | None,
    store: Place | None,
    config: Path | None,
    target_path: Path | None,
    readback: Path | None,
    override: tuple[str, ...],
    reason: tuple[str, ...],
    as_json: bool,
) -> None:
    """Write OUT/serial-NNNN: calibration, target's tables, rollback, report and manifest.

    Refused (exit code 4) unless every gate passes or is overridden; nothing is left behind then.
    """
    from stcal.report.document import VALIDATION_SCHEMA, read_document
    from stcal.report.upload_html import render
    from stcal.uplink.build import Evidence
    from stcal.uplink.build import build as build_upload

    if readback is not None and target_path is None:
        raise UsageError("--readback needs --target, which says how the dump is to be read")
    document = read_document(validation, (VALIDATION_SCHEMA,)) if validation else None
    settings, on_disk = _on_disk(store, config, calibration)
    evidence = Evidence(
        validation=document,
        config=settings,
        on_disk=on_disk,
        target=_target(target_path),
        readback=None if readback is None else _read(readback),
        overrides=_overrides(override, reason),
    )
    built = build_upload(calibration, parent, out, evidence, render)
    emit(_describe(built, validation), as_json, lambda console: _human(built, console))


def _overrides(gates: tuple[str, ...], reasons: tuple[str, ...]) -> dict[str, str]:
    """Return gate -> reason.

    Raises
    ------
    UsageError
    """
    from stcal.uplink.gates import FIXED, GATES

    if len(gates) != len(reasons):
        raise UsageError(f"{len(gates)} --override but {len(reasons)} --reason: one for each")
    for gate, reason in zip(gates, reasons, strict=True):
        if gate not in GATES:
            raise UsageError(f"--override {gate!r} is not a gate; there are {', '.join(GATES)}")
        if gate in FIXED:
            raise UsageError(f"--override {gate}: this gate cannot be overridden")
        if not reason.strip() or not reason.isprintable():
            raise UsageError(f"--reason {reason!r} says nothing")
    if len(set(gates)) < len(gates):
        raise UsageError("a gate is overridden twice")
    return dict(zip(gates, reasons, strict=True))


def _on_disk(
    store: Place | None, config: Path | None, calibration: Path
) -> tuple[SensorConfig | None, dict[str, str] | None]:
    """Return the sensor's configuration, and the hashes of what the fit read, as it is on disk."""
    from stcal.cli.inputs import Selection, read_inputs
    from stcal.config import load_config
    from stcal.reading import read_json_object
    from stcal.times import format_utc, parse_utc

    if store is None:
        return (None if config is None else load_config(config)), None
    document = read_json_object(calibration)
    provenance = document.get("provenance")
    span = provenance if isinstance(provenance, dict) else {}
    first, last, sensor = span.get("from"), span.get("to"), document.get("sensor_id")
    if not (isinstance(first, str) and isinstance(last, str) and isinstance(sensor, str)):
        raise InputError(
            f"{calibration}: its provenance does not say which frames it was fitted to"
        )
    after = format_utc(parse_utc(last) + 1_000_000)
    inputs = read_inputs(Selection(store, sensor, config, first, after))
    keys = ("telemetry_sha256", "catalogue_sha256", "config_sha256")
    return inputs.matcher.config, {key: inputs.provenance[key] for key in keys}


def _target(path: Path | None) -> Any:
    from stcal.uplink.target import load_target

    return None if path is None else (load_target(path), _read(path))


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


@command.command()
@click.argument("folder", type=_FOLDER)
@click.option("--name", required=True, help="Who approves.")
@click.option("--time", "time_utc", help="UTC time of the approval; now if not given.")
@JSON
def approve(folder: Path, name: str, time_utc: str | None, as_json: bool) -> None:
    """Approve the upload in FOLDER: bind a name and a time to its manifest.

    Every file is checked against the manifest first; an approval is never overwritten.
    """
    from dataclasses import asdict
    from datetime import UTC, datetime

    from stcal.times import format_utc
    from stcal.uplink.approve import approve as approve_upload

    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    when = now if time_utc is None else format_utc(_time(time_utc))
    found = approve_upload(folder, name, when)
    line = f"{folder}: approved by {found.name} at {found.time_utc}"
    emit(asdict(found), as_json, lambda console: console.print(line, markup=False))


def _time(text: str) -> int:
    from stcal.times import parse_utc

    try:
        return parse_utc(text)
    except ValueError as error:
        raise UsageError(f"--time {text!r}: {error}") from None


@command.command()
@click.argument("folder", type=_FOLDER)
@click.argument("dump", required=False, type=_FILE)
@click.option("--crc", help="CRC-16/ARC that the spacecraft reports, hexadecimal, e.g. 0xBB3D.")
@JSON
def verify(folder: Path, dump: Path | None, crc: str | None, as_json: bool) -> None:
    """Compare a memory DUMP, or a reported CRC, with the upload in FOLDER.

    Names the fields that differ, the first first; exit code 4 when there are any.
    """
    from dataclasses import asdict

    from stcal.errors import GateRefusalError
    from stcal.uplink.on_board import compare_with_upload

    if (dump is None) == (crc is None):
        raise UsageError("give a DUMP or --crc")
    reported = None if crc is None else _hexadecimal(crc)
    differences = compare_with_upload(folder, None if dump is None else _read(dump), reported)
    document = {"equal": not differences, "differences": [asdict(d) for d in differences]}
    if differences:
        first = differences[0]
        error = GateRefusalError(
            f"not what was built: {len(differences)} differences, first {first.field}: on board "
            f"{first.found}, built {first.built}"
        )
        error.document = document
        if not as_json:
            emit(document, False, lambda console: _differences(differences, console))
        raise error
    emit(document, as_json, lambda console: console.print("equal to what was built"))


def _hexadecimal(text: str) -> int:
    try:
        value = int(text, 16)
    except ValueError:
        value = -1
    if not 0 <= value <= 0xFFFF:
        raise UsageError(f"--crc {text!r} is not a CRC-16 such as 0xBB3D")
    return value


def _differences(found: list[Difference], console: Console) -> None:
    from rich.text import Text

    for d in found:
        where = "" if d.offset is None else f" (byte {d.offset})"
        console.print(Text(f"{d.field}{where}: built {d.built}, on board {d.found}"))


@command.command()
@click.argument("old", type=_FILE)
@click.argument("new", type=_FILE)
@JSON
def diff(old: Path, new: Path, as_json: bool) -> None:
    """Show the change from OLD to NEW per parameter, in units and in sigma."""
    from stcal.calibration import load
    from stcal.report.tables import difference_tables
    from stcal.uplink.compare import compare

    document = compare(load(old), load(new))
    emit(document, as_json, lambda console: difference_tables(document, console))


def _describe(built: Built, validation: Path | None) -> dict[str, Any]:
    return {
        "accepted": True,
        "folder": str(built.folder),
        "sensor_id": built.calibration.sensor_id,
        "serial": built.calibration.serial,
        "parent_serial": built.parent.serial,
        "sha256": {name: facts["sha256"] for name, facts in built.manifest["files"].items()},
        "crc16_arc": built.manifest["crc16_arc"],
        "gates": built.manifest["gates"],
        "overrides": built.manifest["overrides"],
        "validation": str(validation) if validation else None,
        "existed": built.existed,
    }


def _human(built: Built, console: Console) -> None:
    from rich.text import Text

    from stcal.report.terminal import print_table
    from stcal.report.upload_content import gate_table

    state = "already there, unchanged" if built.existed else "written"
    line = f"serial {built.calibration.serial} over {built.parent.serial}: {built.folder} ({state})"
    console.print(Text(line))
    print_table(gate_table(built.manifest), console)
