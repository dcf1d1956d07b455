"""``stcal study tracking``: filters on simulated cameras that change in flight."""

from __future__ import annotations

from pathlib import Path

import click

from stcal.cli.inputs import JSON, OUT, Workforce, workforce_options
from stcal.cli.output import progress, watched
from stcal.cli.paths import output_folder
from stcal.cli.study_output import finish


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
@workforce_options
@JSON
def command(
    out: Path,
    scenarios: Path,
    seed: int,
    runs: int,
    frames: int | None,
    workforce: Workforce,
    as_json: bool,
) -> None:
    """Follow cameras that drift, jump, or only grow warm and cold.

    Writes study.json and report.html into --out: truth against estimate with and without process
    noise, and whether a temperature model is chosen where the data support it.
    """
    from stcal.report.tables import tracking_tables
    from stcal.simulate import load_scenario
    from stcal.studies.tracking import run_study
    from stcal.studies.tracking_cases import CASES, short_scenario

    output_folder(out)
    found = {
        name: short_scenario(case, load_scenario(scenarios / f"{case.scenario}.toml"), frames)
        for name, case in CASES.items()
    }
    with workforce.map() as mapper, progress("study tracking") as bar:
        document = run_study(found, seed, runs, watched(mapper, bar))
    finish(document, out, as_json, tracking_tables)
