"""``stcal study zhang``: the two-stage calibration of Zhang et al. 2024 on simulated images."""

from __future__ import annotations

from pathlib import Path

import click

from stcal.cli.inputs import JSON, OUT, Workforce, workforce_options
from stcal.cli.output import progress, watched
from stcal.cli.paths import output_folder
from stcal.cli.study_output import finish


@click.command(name="zhang")
@OUT
@click.option(
    "--scenario",
    type=click.Path(path_type=Path, dir_okay=False),
    default=Path("configs/scenarios/zhang2024.toml"),
    show_default=True,
    help="Scenario whose orbit, epoch and sensor are used.",
)
@click.option(
    "--runs", type=click.IntRange(min=2, max=10_000), default=100, show_default=True,
    help="Runs with other noise on the same images; the paper has 100.",
)  # fmt: skip
@click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Of the noise."
)
@workforce_options
@JSON
def command(
    out: Path, scenario: Path, runs: int, seed: int, workforce: Workforce, as_json: bool
) -> None:
    """Repeat Zhang, Dong & Zhao 2024 on simulated images.

    Writes study.json and report.html into --out: both stages of the paper's calibration with its
    values beside, the Cramer-Rao bound, other filters on the same images, and which of the paper's
    findings hold.
    """
    from stcal.report.zhang_html import study_tables
    from stcal.simulate import load_scenario
    from stcal.studies.zhang import run_study

    output_folder(out)
    found = load_scenario(scenario)
    with workforce.map() as mapper, progress("study zhang") as bar:
        document = run_study(found, runs, seed, watched(mapper, bar))
    finish(document, out, as_json, study_tables)
