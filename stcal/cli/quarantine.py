"""``stcal quarantine``: look at what ingest refused, and try it again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stcal.cli.inputs import JSON, STORE, StorePlace
from stcal.cli.output import emit, plain

if TYPE_CHECKING:
    from rich.console import Console

    from stcal.telemetry.places import Place

SOURCE = click.option("--source", help="Of this file: its name, or the beginning of its SHA-256.")
SENSOR = click.option("--sensor", help="Of this sensor.")
REASON = click.option("--reason", help="Refused for this reason, e.g. outside_detector.")


@click.group(name="quarantine")
def command() -> None:
    """List, show and try again what ingest refused."""


@command.command(name="list")
@STORE
@SOURCE
@SENSOR
@REASON
@JSON
def list_(
    store: Place, source: str | None, sensor: str | None, reason: str | None, as_json: bool
) -> None:
    """Count the refused telemetry rows by reason, source and sensor."""
    from stcal.telemetry.quarantine_list import Selection, listing
    from stcal.telemetry.store import Store

    opened = Store.open(store)
    found = listing(opened.root, Selection(source, sensor, None, _known(reason))).document()
    emit(found, as_json, lambda console: _list_tables(found, console))


@command.command(name="show")
@STORE
@SOURCE
@SENSOR
@click.option("--frame", help="Of the frame with this number.")
@REASON
@click.option(
    "--limit", type=click.IntRange(1), default=20, show_default=True, help="Records at most."
)
@JSON
def show(
    store: Place,
    source: str | None,
    sensor: str | None,
    frame: str | None,
    reason: str | None,
    limit: int,
    as_json: bool,
) -> None:
    """Show refused records with their bytes: as text, or as a hex dump with offsets."""
    from stcal.telemetry.quarantine_list import Selection, shown
    from stcal.telemetry.store import Store

    opened = Store.open(store)
    selection = Selection(source, sensor, frame, _known(reason))
    records = list(shown(opened.root, selection, limit))
    emit({"records": records}, as_json, lambda console: _print_records(records, console))


@command.command(name="retry")
@click.option(
    "--store", required=True, type=StorePlace(written=True), help="Folder of the Parquet store."
)
@SOURCE
@click.option(
    "--config",
    "config_paths",
    multiple=True,
    type=click.Path(path_type=Path),
    help="A configuration to use from now on; those that the store has recorded if not given.",
)
@JSON
def retry(store: Path, source: str | None, config_paths: tuple[Path, ...], as_json: bool) -> None:
    """Decode the refused records again; what is good now goes into the store.

    Use it after a correction of the sensor's configuration.  A frame that lost against another
    version of it is not tried, since no configuration decides that.
    """
    from stcal.config import load_config
    from stcal.telemetry.retry import retry as retry_core
    from stcal.telemetry.store import Store

    opened = Store.open(store)
    configs = [load_config(path) for path in config_paths] or None
    results = [result.document() for result in retry_core(opened, configs, source)]
    counts = ("refused_rows", "taken_rows", "kept_rows", "frames")
    document: dict[str, Any] = {name: sum(r[name] for r in results) for name in counts}
    document["sources"] = results
    emit(document, as_json, lambda console: _retry_table(document, console))


def _known(reason: str | None) -> str | None:
    from stcal.errors import UsageError
    from stcal.telemetry.quarantine import REASONS

    if reason is not None and reason not in REASONS:
        raise UsageError(f"--reason {reason!r} is not one of: {', '.join(REASONS)}")
    return reason


def _list_tables(found: dict[str, Any], console: Console) -> None:
    from rich.table import Table

    from stcal.telemetry.quarantine import REASONS

    if not found["records"]:
        console.print("nothing is in quarantine")
        return
    table = Table("Reason", "Rows", "What it means")
    for code, rows in found["by_reason"].items():
        table.add_row(code, str(rows), REASONS[code])
    console.print(table)
    table = Table("Source", "SHA-256", "Rows", "Reasons")
    for entry in found["by_source"]:
        rows = entry["rows"]
        table.add_row(entry["source"], entry["sha256"][:12], str(sum(rows.values())), _listed(rows))
    console.print(table)
    table = Table("Sensor", "Rows", "Reasons")
    for name, rows in found["by_sensor"].items():
        table.add_row(name or "(not read)", str(sum(rows.values())), _listed(rows))
    console.print(table)


def _listed(rows: dict[str, int]) -> str:
    return ", ".join(f"{code} {n}" for code, n in rows.items())


def _print_records(records: list[dict[str, Any]], console: Console) -> None:
    from stcal.telemetry.quarantine_list import hex_dump

    if not records:
        console.print("no such record is in quarantine")
    for record in records:
        place = f"offset {record['offset']}" if record["offset"] >= 0 else "no offset"
        of = f"sensor {record['sensor_id'] or '?'}, frame {record['frame_id'] or '?'}"
        lines = [
            f"{record['source']} ({record['source_sha256'][:12]}): row {record['row']}, {place}, "
            f"{record['length']} bytes; {of}",
            f"  {record['code']}: {record['detail']}",
        ]
        raw = bytes.fromhex(record["hex"])
        text = record["text"]
        lines += hex_dump(raw, record["offset"]) if text is None else [text]
        click.echo(plain("\n".join(lines)) + "\n")


def _retry_table(document: dict[str, Any], console: Console) -> None:
    from rich.table import Table

    if not document["sources"]:
        console.print("nothing is in quarantine that could be tried again")
        return
    table = Table("Source", "Rows before", "Taken", "Stay", "Frames", "Reasons or note")
    for entry in document["sources"]:
        counts = [str(entry[k]) for k in ("refused_rows", "taken_rows", "kept_rows", "frames")]
        table.add_row(entry["source"], *counts, entry["note"] or _listed(entry["reasons"]))
    console.print(table)
