"""``stcal packets``: packet layouts explained, and as XTCE."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from stcal.cli.inputs import JSON
from stcal.cli.output import emit

if TYPE_CHECKING:
    from rich.console import Console

LAYOUT = click.argument("layout_file", metavar="LAYOUT.toml", type=click.Path(path_type=Path))


@click.group(name="packets")
def command() -> None:
    """Explain packet layouts, and write them as XTCE."""


@command.command()
@LAYOUT
@JSON
def describe(layout_file: Path, as_json: bool) -> None:
    """Explain a packet layout: every part with its place, type, range and use."""
    from stcal.telemetry.packet_describe import describe as describe_layout
    from stcal.telemetry.packet_layout import load_layout

    document = describe_layout(load_layout(layout_file))
    emit(document, as_json, lambda console: _tables(document, console))


@command.command()
@LAYOUT
@click.option("--out", required=True, type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--lists",
    type=click.Choice(["auto", "expanded", "binary"]),
    default="auto",
    show_default=True,
    help="Lists entry by entry in a container for each combination of lengths, or as binary "
    "parameters with a container of one entry.",
)
@JSON
def xtce(layout_file: Path, out: Path, lists: str, as_json: bool) -> None:
    """Write a packet layout as an XTCE 1.2 definition."""
    from stcal.atomic import write_text
    from stcal.telemetry.packet_layout import load_layout
    from stcal.telemetry.packet_xtce import Lists
    from stcal.telemetry.packet_xtce import xtce as xtce_of

    text = xtce_of(load_layout(layout_file), cast("Lists", lists))
    write_text(out, text)
    document = {
        "layout": str(layout_file),
        "file": str(out),
        "containers": text.count("<SequenceC"),
    }
    emit(
        document,
        as_json,
        lambda console: console.print(
            f"{out}: {document['containers']} containers", highlight=False, soft_wrap=True
        ),
    )


def _tables(document: dict[str, Any], console: Console) -> None:
    from rich.table import Column, Table

    sizes, time = document["packet_bytes"], document["time"]
    others = document["ignored_apids"] or "idle packets only"
    sensors = ", ".join(f"{name} {apid}" for name, apid in document["apids"].items())
    lines = [
        f"{document['name']}. {document['description']}",
        f"APIDs: {sensors}; also in the stream: {others}",
        f"{sizes['smallest']} to {sizes['largest']} bytes, "
        f"error control {document['error_control']}",
        f"Time: {time['code']} of {time['bytes']} bytes, {time['scale']} since {time['epoch']}, "
        f"one count {time['resolution_ns']:g} ns",
    ]
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True, markup=False)
    # The last one: the unit of the telemetry column that the part becomes.
    titles = ("Place", "Type", "Unit", "Range", "Step", "Becomes")
    columns = [Column(title, overflow="fold") for title in titles]
    table = Table(Column("Part", no_wrap=True), *columns)
    for part in document["parts"]:
        table.add_row(*_row(part))
        for field in part.get("fields", []):
            table.add_row(*_row(field, "  "))
    console.print(table)


def _row(part: dict[str, Any], indent: str = "") -> list[str]:
    """Return the cells of a part; its place is byte and bit from the last list's end on."""
    name, place = indent + part["part"], _place(part)
    if "list" in part:
        how = f"{part['maximum']} always" if part["always_full"] else f"0 to {part['maximum']}"
        what = f"list of {part['list']}, {how}, by {part['count']}"
        return [name, place, what, "", "", "", ""]
    if "type" not in part:
        return [name, place, f"{part['bits']} bits", "", "", "", ""]
    kind = part["type"] + (" little-endian" if part["byte_order"] == "little" else "")
    limits = "" if part["smallest"] is None else f"{part['smallest']:.4g} to {part['largest']:.4g}"
    step = "" if part["smallest"] is None else f"{part['scale']:.3g}"
    becomes = part["column_unit"] if part["column"] else ""
    return [name, place, kind, part["unit"], limits, step, becomes]


def _place(part: dict[str, Any]) -> str:
    if part["bit"] is None:
        return "end"
    byte, bit = divmod(part["bit"], 8)
    where = f"{byte}" + (f".{bit}" if bit else "")
    return where if part.get("after") is None else f"{part['after']} + {where}"
