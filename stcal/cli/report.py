"""``stcal report``: make the HTML report of a fit, a validation, or both."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stcal.cli.output import emit
from stcal.cli.paths import output_file
from stcal.errors import UsageError

if TYPE_CHECKING:
    from rich.console import Console


@click.command(name="report")
@click.argument("documents", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--out", required=True, type=click.Path(path_type=Path, dir_okay=False), help="HTML file."
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def command(documents: tuple[Path, ...], out: Path, as_json: bool) -> None:
    """Make one HTML report of fit.json or validation.json, or of both in one file."""
    from stcal.report.document import FIT_SCHEMA, VALIDATION_SCHEMA, read_document, text
    from stcal.report.html import RENDERERS, write_recalibration, write_report

    output_file(out)
    found = [read_document(path, tuple(RENDERERS)) for path in documents]
    by_schema = {document["schema"]: document for document in found}
    file_of = {document["schema"]: path for document, path in zip(found, documents, strict=True)}
    if len(found) == 1:
        write_report(found[0], out)
    elif len(found) == 2 and {FIT_SCHEMA, VALIDATION_SCHEMA} <= set(by_schema):
        fit, validation = by_schema[FIT_SCHEMA], by_schema[VALIDATION_SCHEMA]
        files = (file_of[FIT_SCHEMA], file_of[VALIDATION_SCHEMA])
        write_recalibration(fit, validation, out, files)
    else:
        raise UsageError("give one document, or one fit and one validation")
    result: dict[str, Any] = {
        "report": str(out),
        "sensor_id": text(found[0].get("sensor_id")) or None,
        "schemas": [document["schema"] for document in found],
    }
    emit(result, as_json, lambda console: _human(out, console))


def _human(out: Path, console: Console) -> None:
    from rich.text import Text

    console.print(Text(f"report: {out}"))
