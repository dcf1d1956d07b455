"""``stcal ingest``: read downlinked telemetry into a Parquet store."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from stcal.cli.inputs import StorePlace
from stcal.cli.output import emit, progress
from stcal.errors import InputError, UsageError

if TYPE_CHECKING:
    from rich.console import Console

    from stcal.telemetry.packet_layout import PacketLayout
    from stcal.telemetry.summary import IngestSummary

# Counts of the summary and their titles; those not in _ALWAYS are shown when there are any.
_COLUMNS = {
    "rows": "Rows",
    "frames": "Frames",
    "new_frames": "New",
    "replaced_frames": "Better",
    "duplicate_frames": "Known",
    "conflicting_frames": "Worse",
    "stars": "Stars",
    "quarantined_rows": "Refused rows",
}
_ALWAYS = ("rows", "frames", "new_frames", "duplicate_frames", "stars", "quarantined_rows")


@click.command(name="ingest")
@click.argument("sources", nargs=-1, required=True, type=click.Path(path_type=Path, readable=False))
@click.option(
    "--store",
    "store_path",
    required=True,
    type=StorePlace(written=True),
    help="The store's folder; made where there is none.",
)
@click.option(
    "--config",
    "config_paths",
    required=True,
    multiple=True,
    type=click.Path(path_type=Path),
    help="A sensor configuration; may be given several times.",
)
@click.option(
    "--packets",
    "layout_path",
    type=click.Path(path_type=Path),
    help="The layout of CCSDS packets: files that are no text are packets back to back, or an "
    "OpenC3 COSMOS log.",
)
@click.option(
    "--mapping",
    "mapping_path",
    type=click.Path(path_type=Path),
    help="The sources are tables of another tool: the column mapping that describes them.",
)
@click.option(
    "--workers",
    type=click.IntRange(1, 256),
    default=lambda: min(os.cpu_count() or 1, 4),
    help="Threads that read files ahead; the processor's cores up to 4 if not given. The store is "
    "the same.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
@click.pass_context
def command(
    context: click.Context,
    sources: tuple[Path, ...],
    store_path: Path,
    config_paths: tuple[Path, ...],
    mapping_path: Path | None,
    layout_path: Path | None,
    workers: int,
    as_json: bool,
) -> None:
    """Read telemetry SOURCEs (files or folders; CSV or JSON Lines, plain or gzip) into a store.

    With --packets, files that are no text are CCSDS packets or OpenC3 COSMOS logs, and the lost
    packets of each APID are counted; a folder's are *.ccsds, *.bin and *.pkt.
    Rows and frames that are refused go to the store's quarantine with source, row and reason.  Of
    two versions of a frame the one with more stars is kept.
    """
    from stcal.config import load_config
    from stcal.telemetry.ingest import ingest
    from stcal.telemetry.mapping import load_mapping
    from stcal.telemetry.store import Store

    configs = [load_config(path) for path in config_paths]
    if layout_path is not None and mapping_path is not None:
        raise UsageError("--packets and --mapping exclude each other")
    layout = _layout(layout_path)
    mapping = None if mapping_path is None else load_mapping(mapping_path)
    store = Store.open(store_path, create=True)
    with progress("ingest", total=1.0) as bar:
        done = 0.0

        def step(name: str, files: int, total: int) -> None:
            nonlocal done
            share = files / total if total else 1.0
            bar.describe(f"ingest {name}")
            bar.advance(share - done)
            done = share

        summary = ingest(
            sources,
            store,
            configs,
            progress=step,
            packets=layout,
            mapping=mapping,
            workers=workers,
        )
    _finish(context, summary, as_json)


def _layout(path: Path | None) -> PacketLayout | None:
    from stcal.telemetry.packet_layout import load_layout

    return load_layout(path) if path is not None else None


def _finish(context: click.Context, summary: IngestSummary, as_json: bool) -> None:
    """Print the summary and leave with its exit code."""
    if summary.errors:
        failure = InputError("\n".join(summary.errors))
        failure.document = summary.document()
        if not as_json:
            emit(failure.document, False, lambda console: _tables(summary, console))
        raise failure
    emit(summary.document(), as_json, lambda console: _tables(summary, console))
    if summary.exit_code:
        click.echo(
            f"stcal: {summary.quarantine_share:.1%} of the rows went to quarantine, more than "
            f"the {summary.maximum_quarantine_share:.1%} that the configuration allows",
            err=True,
        )
    context.exit(summary.exit_code)


def _tables(summary: IngestSummary, console: Console) -> None:
    from rich.table import Column, Table

    shown = [
        (name, title)
        for name, title in _COLUMNS.items()
        if name in _ALWAYS or getattr(summary.counts, name)
    ]
    table = Table(Column("Source", overflow="fold"))
    for _, title in shown:
        table.add_column(title, justify="right")
    for source in summary.sources:
        name = source.path.name + (" (damaged)" if source.error else "")
        table.add_row(name, *(str(getattr(source.counts, count)) for count, _ in shown))
    if len(summary.sources) > 1:
        table.add_section()
        total = summary.counts
        table.add_row("total", *(str(getattr(total, count)) for count, _ in shown))
    console.print(table)
    _packets_table(summary, console)
    _quarantine_table(summary, console)
    for source in summary.sources:
        for warning in source.warnings:
            console.print(f"{source.path.name}: {warning}", markup=False)


def _packets_table(summary: IngestSummary, console: Console) -> None:
    from rich.table import Column, Table

    found = [(source, source.packets) for source in summary.sources if source.packets is not None]
    if not found:
        return
    table = Table(Column("Source", overflow="fold"), "Sensor", "APID")
    for title in ("Packets", "Duplicates", "Gaps", "Lost", "Numbers used again"):
        table.add_column(title, justify="right")
    for source, packets in found:
        for one in packets["apids"]:
            counts = ("packets", "duplicates", "gaps", "lost", "reused_numbers")
            numbers = [str(one[name]) for name in counts]
            table.add_row(source.path.name, one["sensor_id"], str(one["apid"]), *numbers)
        if packets["other_packets"]:
            table.add_row(source.path.name, "", "others", str(packets["other_packets"]))
    console.print(table)


def _quarantine_table(summary: IngestSummary, console: Console) -> None:
    from rich.table import Table

    from stcal.telemetry.quarantine import REASONS

    if not summary.quarantined:
        return
    table = Table("Quarantine", "Rows", "What it means")
    for code, rows in summary.quarantined.items():
        table.add_row(code, str(rows), REASONS[code])
    console.print(table)
