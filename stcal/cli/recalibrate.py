"""``stcal recalibrate``: a shift's work on all sensors of a plan."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stcal.cli.inputs import JSON
from stcal.cli.output import emit, progress, write_documents
from stcal.cli.paths import own_folder

if TYPE_CHECKING:
    from rich.console import Console

    from stcal.operations.record import Outcome

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
@JSON
@click.pass_context
def command(context: click.Context, plan: Path, workers: int, as_json: bool) -> None:
    """Ingest, fit, validate and build the uploads of all sensors that PLAN.toml lists.

    A sensor that fails or is refused doesn't stop the others.  Run again, it goes on where it
    ended: a step whose command, inputs and outputs are unchanged isn't repeated.  Ends with the
    worst exit code.
    """
    from stcal.execution import scheduler
    from stcal.operations.plan import load_plan
    from stcal.operations.run import STEPS_PER_SENSOR, Runner, recalibrate
    from stcal.operations.summary import fleet_document

    file = load_plan(plan)
    file.sources()  # a name that finds nothing is told before the work
    own_folder(file.out)
    total = 1 + STEPS_PER_SENSOR * len(file.plan.sensors)
    with scheduler(workers) as mapper, progress("recalibrate", total=total) as bar:

        def on_step(sensor: str, outcome: Outcome) -> None:
            bar.describe(f"recalibrate {sensor} {outcome.name}")
            bar.advance()

        run = recalibrate(file, mapper, Runner(), on_step)
    document = fleet_document(file, run)
    write_documents(document, file.out / DOCUMENT, file.out / INDEX)
    emit(document, as_json, lambda console: _table(document, file.out, console))
    context.exit(run.exit_code)


def _table(document: dict[str, Any], out: Path, console: Console) -> None:
    from rich.text import Text

    from stcal.report.tables import fleet_tables

    fleet_tables(document, console)
    console.print(Text(f"index: {out / INDEX}"), soft_wrap=True)
