"""``stcal study tracking``: filters on simulated cameras that change in flight."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stcal.cli.inputs import JSON, OUT, WORKERS
from stcal.cli.output import emit, progress
from stcal.cli.paths import output_folder

if TYPE_CHECKING:
    from rich.console import Console

DOCUMENT, REPORT = "study.json", "report.html"


@click.command(name="tracking")
@OUT
@click.option(
    "--scenarios",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("configs/scenarios"),
    show_default=True,
    help="Folder of the scenarios st16-drift.toml, st16-step.toml and st16-1.toml.",
)
@click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Of the first run."
)
@click.option(
    "--runs",
    type=click.IntRange(1, 100),
    default=4,
    show_default=True,
    help="Simulations of each camera, with seeds one after the other.",
)
@click.option(
    "--frames",
    type=click.IntRange(min=200),
    help="Calibration frames of each camera; the scenarios' own without it.",
)
@WORKERS
@JSON
def command(
    out: Path,
    scenarios: Path,
    seed: int,
    runs: int,
    frames: int | None,
    workers: int,
    as_json: bool,
) -> None:
    """Follow cameras that drift, jump, or only grow warm and cold.

    Writes study.json and report.html into --out: truth against estimate with and without process
    noise, and whether a temperature model is chosen where the data support it.
    """
    from stcal.cli.fit import write_documents
    from stcal.execution import scheduler
    from stcal.simulate import load_scenario
    from stcal.studies.tracking import run_study
    from stcal.studies.tracking_cases import CASES, short_scenario

    output_folder(out)
    found = {
        name: short_scenario(case, load_scenario(scenarios / f"{case.scenario}.toml"), frames)
        for name, case in CASES.items()
    }
    total = runs * len(found)
    with scheduler(workers) as mapper, progress("study tracking", total=total) as bar:
        document = run_study(found, seed, runs, mapper, bar.advance)
    write_documents(document, out / DOCUMENT, out / REPORT)
    emit(document, as_json, lambda console: _tables(document, out / REPORT, console))


def _tables(document: dict[str, Any], report: Path, console: Console) -> None:
    from rich.text import Text

    from stcal.report.tables import tracking_tables

    tracking_tables(document, console)
    console.print(Text(f"report: {report}"), soft_wrap=True)
