"""``stcal summary``: one table of several validations."""

from __future__ import annotations

from pathlib import Path

import click

from stcal.cli.output import emit


@click.command(name="summary")
@click.argument("validations", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def command(validations: tuple[Path, ...], as_json: bool) -> None:
    """Print one line per validation.json, in the shape of Enright 2018 Table IV."""
    from stcal.report.content import summary_row
    from stcal.report.document import VALIDATION_SCHEMA, read_document
    from stcal.report.tables import summary_table

    rows = [summary_row(read_document(path, (VALIDATION_SCHEMA,))) for path in validations]
    document = {"schema": "stcal.summary/1", "sensors": rows}
    emit(document, as_json, lambda console: summary_table(rows, console))
