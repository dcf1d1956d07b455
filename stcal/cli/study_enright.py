"""``stcal study enright``: the tests of Enright, Jovanovic & Vaz 2018 on simulated sensors."""

from __future__ import annotations

from pathlib import Path

import click

from stcal.cli.inputs import JSON, OUT, Workforce, workforce_options
from stcal.cli.output import progress, watched
from stcal.cli.paths import output_folder
from stcal.cli.study_output import finish


@click.command(name="enright")
@OUT
@click.option(
    "--scenarios",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("configs/scenarios"),
    show_default=True,
    help="Folder of the sensors' scenarios st16-1.toml to st16-6.toml.",
)
@click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Of the simulation."
)
@click.option(
    "--sensors", default="1,2,3,4,5,6", show_default=True, help="The paper's sensors to run."
)
@click.option(
    "--frames",
    type=click.IntRange(min=20),
    help="Calibration frames of each sensor, half as many for validation; the scenarios' own "
    "without it.",
)
@workforce_options
@JSON
def command(
    out: Path,
    scenarios: Path,
    seed: int,
    sensors: str,
    frames: int | None,
    workforce: Workforce,
    as_json: bool,
) -> None:
    """Repeat Enright, Jovanovic & Vaz 2018 on simulated sensors.

    Writes study.json and report.html into --out: Tables III to VII and Figures 3 to 5 with the
    paper's values beside, and which of its findings hold.
    """
    from stcal.report.tables import enright_tables
    from stcal.simulate import load_scenario
    from stcal.studies.enright import run_study
    from stcal.studies.scenarios import shortened

    chosen = _numbers(sensors)
    output_folder(out)
    found = {n: shortened(load_scenario(scenarios / f"st16-{n}.toml"), frames) for n in chosen}
    with workforce.map() as mapper, progress("study enright") as bar:
        document = run_study(found, seed, watched(mapper, bar))
    finish(document, out, as_json, enright_tables)


def _numbers(sensors: str) -> list[int]:
    from stcal.errors import UsageError
    from stcal.studies.enright_paper import SENSORS

    known = {str(number): number for number in SENSORS}
    named = [item.strip() for item in sensors.split(",")]
    unknown = [item for item in named if item not in known]
    if unknown or len(set(named)) != len(named):
        raise UsageError(f"--sensors {sensors!r}: give each of {', '.join(known)} at most once")
    return [known[item] for item in named]
