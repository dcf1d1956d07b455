"""``stcal recalibrate``: a shift's work on all sensors of a plan."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stcal.cli.inputs import JSON, SCHEDULER
from stcal.cli.output import emit, progress, watched, write_documents
from stcal.cli.paths import own_folder

if TYPE_CHECKING:
    from rich.console import Console

DOCUMENT, INDEX = "recalibration.json", "index.html"


@click.command(name="recalibrate")
@click.argument("plan", metavar="PLAN.toml", type=click.Path(path_type=Path))
@click.option(
    "--workers",
    type=click.IntRange(1, 64),
    default=1,
    show_default=True,
    help="Sensors at the same time. The result is the same.",
)
@SCHEDULER
@JSON
@click.pass_context
def command(
    context: click.Context, plan: Path, workers: int, scheduler_name: str, as_json: bool
) -> None:
    """Ingest, fit, validate and build the uploads of all sensors that PLAN.toml lists.

    A sensor that fails or is refused doesn't stop the others.  Run again, it goes on where it
    ended: a step whose command, inputs and outputs are unchanged isn't repeated.  Ends with the
    worst exit code.
    """
    from stcal.execution import scheduler
    from stcal.operations.plan import load_plan
    from stcal.operations.run import recalibrate
    from stcal.operations.summary import fleet_document

    file = load_plan(plan)
    file.sources()  # a name that finds nothing is told before the work
    own_folder(file.out)
    # One sensor's work is long, or all done before: none waits behind another's in a batch.
    opened = scheduler(workers, scheduler_name, largest_batch=1)
    with opened as mapper, progress("recalibrate") as bar:
        run = recalibrate(file, watched(mapper, bar))
    document = fleet_document(file, run)
    write_documents(document, file.out / DOCUMENT, file.out / INDEX)
    emit(document, as_json, lambda console: _table(document, file.out, console))
    context.exit(run.exit_code)


def _table(document: dict[str, Any], out: Path, console: Console) -> None:
    from rich.text import Text

    from stcal.report.tables import fleet_tables

    fleet_tables(document, console)
    console.print(Text(f"index: {out / INDEX}"), soft_wrap=True)
