"""``stcal study estimators``: every combination of camera, residual and estimator, measured."""

from __future__ import annotations

import os
from pathlib import Path

import click

from stcal.cli.inputs import JSON, OUT, Workforce, workforce_options
from stcal.cli.output import progress, watched
from stcal.cli.paths import output_folder
from stcal.cli.study_output import finish

RUNS, FRAMES, SEED = 10, 200, 1


@click.command(name="estimators")
@OUT
@click.option(
    "--scenarios",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("configs/scenarios"),
    show_default=True,
    help="Folder of the sensors' scenarios st16-4.toml, wu2019.toml and zhang2024.toml.",
)
@click.option(
    "--runs", type=click.IntRange(1, 10_000), default=RUNS, show_default=True,
    help="Runs of each sensor, and under each bad start and share of false matches.",
)  # fmt: skip
@click.option(
    "--frames", type=click.IntRange(30, 100_000), default=FRAMES, show_default=True,
    help="Frames of a run.",
)  # fmt: skip
@click.option(
    "--seed", type=click.IntRange(min=0), default=SEED, show_default=True, help="Of the first run."
)
@click.option(
    "--page",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write the documentation's page (Markdown) too, with two plots beside it.",
)
@workforce_options
@JSON
def command(
    out: Path,
    scenarios: Path,
    runs: int,
    frames: int,
    seed: int,
    page: Path | None,
    workforce: Workforce,
    as_json: bool,
) -> None:
    """Measure every combination of camera, residual and estimator on simulated sensors.

    Writes study.json and report.html into --out: which combination to use, accuracy against the
    bound, time, memory, and robustness to a bad start and to false matches.
    """
    # Times are those of one thread: linear algebra must not start its own beside the workers.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from stcal.report.estimators_html import study_tables
    from stcal.report.estimators_page import write_page
    from stcal.simulate import load_scenario
    from stcal.studies.estimators import SCENARIOS, run_study

    found = {name: load_scenario(scenarios / f"{name}.toml") for name in SCENARIOS}
    output_folder(out)
    with workforce.map() as mapper, progress("study estimators") as bar:
        document = run_study(found, runs, frames, seed, watched(mapper, bar))
    if page is not None:
        output_folder(page.parent)
        write_page(document, page, _repeat(out, page, runs, frames, seed))
    finish(document, out, as_json, study_tables)


def _repeat(out: Path, page: Path, runs: int, frames: int, seed: int) -> str:
    """Return the command line that repeats the study."""
    changed = {"--runs": (runs, RUNS), "--frames": (frames, FRAMES), "--seed": (seed, SEED)}
    options = [f"{name} {value}" for name, (value, usual) in changed.items() if value != usual]
    return " ".join([f"stcal study estimators --out {out} --page {page}", *options])
