"""``stcal study wu``: the simulations of Wu et al. 2019, many times over."""

from __future__ import annotations

from pathlib import Path

import click

from stcal.cli.inputs import JSON, OUT, Workforce, workforce_options
from stcal.cli.output import progress, watched
from stcal.cli.paths import output_folder
from stcal.cli.study_output import finish


@click.command(name="wu")
@OUT
@click.option(
    "--config",
    type=click.Path(path_type=Path, dir_okay=False),
    default=Path("configs/wu2019.toml"),
    show_default=True,
    help="Sensor configuration; its nominal camera takes the images.",
)
@click.option(
    "--runs", type=click.IntRange(min=1, max=10_000), default=20, show_default=True,
    help="Runs, each with other images and other noise; the paper has one.",
)  # fmt: skip
@click.option(
    "--images", type=click.IntRange(min=200, max=100_000), default=2500, show_default=True,
    help="Images of a run; the last 100 judge the calibration by the others.",
)  # fmt: skip
@click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Of the simulation."
)
@workforce_options
@JSON
def command(
    out: Path, config: Path, runs: int, images: int, seed: int, workforce: Workforce, as_json: bool
) -> None:
    """Repeat Wu et al. 2019 on simulated images.

    Writes study.json and report.html into --out: Tables 2 to 4 and Figures 3, 4 and 6 with the
    paper's values beside, what the data allow, and which of the paper's findings hold.
    """
    from stcal.config import load_config
    from stcal.report.wu_html import study_tables
    from stcal.studies.wu import run_study

    sensor = load_config(config)
    output_folder(out)
    with workforce.map() as mapper, progress("study wu") as bar:
        document = run_study(sensor, runs, seed, watched(mapper, bar), images)
    finish(document, out, as_json, study_tables)
