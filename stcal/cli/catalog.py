"""``stcal catalog build`` and ``stcal catalog info``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stcal.cli.output import emit
from stcal.cli.paths import output_file

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from stcal.catalog.catalogue import StarCatalogue

_FILE = click.Path(path_type=Path)


@click.group(name="catalog")
def command() -> None:
    """Build or describe a star catalogue."""


@command.command()
@click.option(
    "--tycho2",
    type=_FILE,
    multiple=True,
    required=True,
    help="tyc2.dat of CDS I/259, or one of its parts (repeat the option), plain or gzip.",
)
@click.option("--supplement", type=_FILE, help="suppl_1.dat of CDS I/259.")
@click.option("--hipparcos", type=_FILE, help="hip2.dat of CDS I/311.")
@click.option("--limit", type=float, default=8.0, show_default=True, help="Faintest V kept.")
@click.option("--out", type=_FILE, required=True, help="The catalogue file to write (.npz).")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def build(
    tycho2: tuple[Path, ...],
    supplement: Path | None,
    hipparcos: Path | None,
    limit: float,
    out: Path,
    as_json: bool,
) -> None:
    """Make a catalogue of the official fixed-width files."""
    from stcal.catalog.build import build_catalogue
    from stcal.catalog.catalogue import save

    output_file(out)
    catalogue = build_catalogue(tycho2, supplement, hipparcos, limit)
    save(catalogue, out)
    _show(catalogue, out, as_json)


@command.command()
@click.argument("file", required=False, type=_FILE)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def info(file: Path | None, as_json: bool) -> None:
    """Describe a catalogue FILE; the one that comes with stcal by default."""
    from stcal.catalog.catalogue import BUNDLED, load

    path = BUNDLED if file is None else file
    _show(load(path), path, as_json)


def _show(catalogue: StarCatalogue, path: Path, as_json: bool) -> None:
    from stcal.catalog.summary import summarise

    document = {"file": str(path), **summarise(catalogue)}
    emit(document, as_json, lambda console: _print(document, console))


def _print(document: dict[str, Any], console: Console) -> None:
    from rich.table import Table
    from rich.text import Text

    provenance = document["provenance"]
    console.print(Text(str(provenance.get("title", "Star catalogue")), style="bold"))
    facts = Table(show_header=False, box=None)
    facts.add_column()
    facts.add_column(overflow="fold")
    rows = {
        "File": document["file"],
        "Columns' SHA-256": document["sha256"],
        "Stars": f"{document['stars']:,}",
        "Frame, epoch": f"{document['frame']}, {document['epoch']}",
        "Flagged multiple": f"{document['multiple']:,}",
        "Photocentres": f"{document['merged']:,}",
        "With proper motion": f"{document['with_motion']:,}",
        "With parallax": f"{document['with_parallax']:,}",
        "With colour": f"{document['with_colour']:,}",
        "Fastest": f"{document['fastest_mas_per_year']:,.0f} mas/yr",
    }
    for name, digest in provenance.get("inputs", {}).items():
        rows[f"Made from {name}"] = digest
    for name, value in rows.items():
        facts.add_row(name, str(value))
    console.print(facts)
    for warning in document["warnings"]:
        console.print(Text(f"warning: {warning}", style="yellow"))
    console.print(_magnitudes(document))
    console.print(_sources(document))


def _magnitudes(document: dict[str, Any]) -> Table:
    from rich.table import Table

    table = Table("V over", "to", title="Stars by magnitude")
    table.add_column("stars", justify="right")
    table.add_column("so far", justify="right")
    for row in document["by_magnitude"]:
        cells = (str(row["from"]), str(row["to"]), f"{row['stars']:,}", f"{row['so_far']:,}")
        table.add_row(*cells)
    return table


def _sources(document: dict[str, Any]) -> Table:
    from rich.table import Table

    table = Table("Source", title="Stars by source")
    table.add_column("stars", justify="right")
    table.add_column("meaning")
    for row in document["by_source"]:
        table.add_row(row["source"], f"{row['stars']:,}", row["meaning"])
    return table
