"""``stcal fit``: refit the camera from stored telemetry."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stcal.cli.inputs import OUT, Selection, read_inputs, store_options
from stcal.cli.output import emit, progress
from stcal.cli.paths import output_folder

if TYPE_CHECKING:
    from rich.console import Console


@click.command(name="fit")
@click.option("--batch", is_flag=True, help="Fit all frames at once, in cycles of rematching.")
@click.option(
    "--initial",
    required=True,
    type=click.Path(path_type=Path),
    help="Calibration to start from: the one on board.",
)
@click.option(
    "--matches",
    type=click.Choice(["telemetry", "lost-in-space", "guided"]),
    default="lost-in-space",
    show_default=True,
    help="Where the first cycle's star matches come from.",
)
@OUT
@store_options
def command(
    batch: bool,
    initial: Path,
    matches: str,
    out: Path,
    selection: Selection,
    workers: int,
    as_json: bool,
) -> None:
    """Refit the camera and update C_SD.

    Writes fit.json and report.html into --out, and calibration.json when every gate lets the fit
    pass; a refused fit ends with exit code 4 and its reasons.
    """
    from stcal.calibration import load, save, sha256_of
    from stcal.errors import UsageError
    from stcal.execution import scheduler
    from stcal.pipeline.fit import fit_batch, refusal_of

    if not batch:
        raise UsageError("say how to fit: --batch")
    target = output_folder(out) / "calibration.json"
    parent = load(initial)
    inputs = read_inputs(selection)
    provenance = inputs.provenance | {"parent_sha256": sha256_of(initial)}
    limit = inputs.matcher.config.fit.maximum_cycles
    with scheduler(workers) as mapper, progress(f"fit {selection.sensor}", total=limit) as bar:
        result = fit_batch(
            inputs.batches, parent, inputs.matcher, provenance, matches, mapper,
            lambda cycle: bar.advance(),
        )  # fmt: skip
    document = result.document
    # The calibration goes first and comes last: beside documents it is always theirs.
    target.unlink(missing_ok=True)
    write_documents(document, out / "fit.json", out / "report.html")
    if result.calibration is not None:
        save(result.calibration, target)
    else:
        if not as_json:
            emit(document, as_json, lambda console: _tables(document, console))
        raise refusal_of(document)
    emit(document, as_json, lambda console: _tables(document, console))


def write_documents(document: dict[str, Any], path: Path, report: Path) -> None:
    """Write a document and the HTML report made of it."""
    from stcal.atomic import write_text
    from stcal.calibration import canonical_json
    from stcal.report.html import write_report

    write_text(path, canonical_json(document))
    write_report(document, report)


def _tables(document: dict[str, Any], console: Console) -> None:
    from stcal.report.tables import fit_tables

    fit_tables(document, console)
