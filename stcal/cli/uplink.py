"""``stcal uplink``: build an upload, compare two calibrations."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stcal.cli.output import emit

if TYPE_CHECKING:
    from rich.console import Console

    from stcal.uplink.build import Built

_FILE = click.Path(path_type=Path, dir_okay=False)


@click.group(name="uplink")
def command() -> None:
    """Build and compare calibration upload files."""


@command.command()
@click.option("--calibration", required=True, type=_FILE, help="The fitted calibration file.")
@click.option("--parent", required=True, type=_FILE, help="The calibration file on board.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Upload directory.")
@click.option("--validation", type=_FILE, help="validation.json of these two calibrations.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def build(
    calibration: Path, parent: Path, out: Path, validation: Path | None, as_json: bool
) -> None:
    """Write OUT/serial-NNNN with the calibration file and its parameter table.

    Refused (exit code 4) unless every gate passes; nothing is left behind then.
    """
    from stcal.report.document import VALIDATION_SCHEMA, read_document
    from stcal.uplink.build import build as build_upload

    document = read_document(validation, (VALIDATION_SCHEMA,)) if validation else None
    built = build_upload(calibration, parent, out, document)
    if document is None:
        click.echo("stcal: no --validation: nothing proves this upload on held-out data", err=True)
    emit(_describe(built, validation), as_json, lambda console: _human(built, console))


@command.command()
@click.argument("old", type=_FILE)
@click.argument("new", type=_FILE)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
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
        "sha256": built.sha256,
        "validation": str(validation) if validation else None,
        "existed": built.existed,
    }


def _human(built: Built, console: Console) -> None:
    from rich.text import Text

    state = "already there, unchanged" if built.existed else "written"
    line = f"serial {built.calibration.serial} over {built.parent.serial}: {built.folder} ({state})"
    console.print(Text(line))
