"""``stcal simulate``: telemetry of a simulated sensor, with its truth."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from stcal.cli.output import emit, progress
from stcal.cli.paths import output_folder

if TYPE_CHECKING:
    from rich.console import Console

    from stcal.simulate import Scenario
    from stcal.telemetry.packet_layout import PacketLayout

T = TypeVar("T")
U = TypeVar("U")


@click.command(name="simulate")
@click.argument("scenario_file", metavar="SCENARIO.toml", type=click.Path(path_type=Path))
@click.option(
    "--out",
    required=True,
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder for the telemetry, the initial calibration and truth/.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=1,
    show_default=True,
    help="The same scenario and seed give the same bytes.",
)
@click.option(
    "--truth-columns/--no-truth-columns",
    default=True,
    help="Also write the truth of every star and exposure (truth/*.truth.npz).",
)
@click.option(
    "--packets",
    "layout_file",
    type=click.Path(path_type=Path),
    help="Also write the telemetry as CCSDS packets of this layout.",
)
@click.option(
    "--frames",
    type=click.IntRange(min=1),
    help="Calibration frames, in place of the scenario's: the last segment is cut or lengthened.",
)
@click.option(
    "--fragments",
    is_flag=True,
    help="Write calibration/, validation/, body/, truth/ and packets/ with a file for each UTC "
    "day, e.g. calibration/ST16-1.calibration.2014-02-10.csv.gz, made one by one: for runs that "
    "don't fit in memory.",
)
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Processes that make fragments; the files don't depend on their number.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def command(
    scenario_file: Path,
    out: Path,
    seed: int,
    truth_columns: bool,
    layout_file: Path | None,
    frames: int | None,
    fragments: bool,
    workers: int,
    as_json: bool,
) -> None:
    """Make telemetry of a simulated sensor, as SCENARIO.toml describes it."""
    from stcal.simulate import load_scenario, with_frames
    from stcal.telemetry.packet_layout import load_layout

    if workers > 1 and not fragments:
        raise click.UsageError("--workers belongs to --fragments")
    output_folder(out)
    layout = load_layout(layout_file) if layout_file is not None else None
    scenario = load_scenario(scenario_file)
    if frames is not None:
        scenario = with_frames(scenario, "calibration", frames)
    make = partial(_in_fragments, workers=workers) if fragments else _at_once
    made = make(scenario, seed, out, truth_columns, layout)
    document: dict[str, Any] = {
        "sensor_id": scenario.sensor_id,
        "scenario": str(scenario_file),
        "seed": seed,
        "files": {name: str(path) for name, path in made["files"].items()},
        "parts": made["parts"],
    }
    emit(document, as_json, lambda console: _table(document, console))


def _at_once(
    scenario: Scenario, seed: int, out: Path, truth_columns: bool, layout: PacketLayout | None
) -> dict[str, Any]:
    from stcal.simulate import simulate
    from stcal.simulate.files import summary, write_packets, write_simulation

    with progress(f"Simulating {scenario.sensor_id}", total=2) as bar:
        simulation = simulate(scenario, seed)
        bar.advance(1)
        bar.describe(f"Writing {out}")
        files = write_simulation(simulation, out, truth_columns)
        if layout is not None:
            files |= write_packets(simulation, layout, out)
        bar.advance(1)
    return {"files": files, "parts": summary(simulation)}


def _in_fragments(
    scenario: Scenario,
    seed: int,
    out: Path,
    truth_columns: bool,
    layout: PacketLayout | None,
    workers: int,
) -> dict[str, Any]:
    from stcal.execution import scheduler
    from stcal.simulate.fragments import Output, lay_out, write_fragments

    plan, output = lay_out(scenario, seed), Output(out, truth_columns, layout)
    total = len(plan.fragments)
    name = "serial" if workers == 1 else "processes"
    with (
        progress(f"Simulating {scenario.sensor_id}", total) as bar,
        scheduler(workers, name) as run,
    ):
        return write_fragments(plan, output, run, lambda: bar.advance(1))


def _table(document: dict[str, Any], console: Console) -> None:
    from rich.table import Table

    title = f"{document['sensor_id']}, seed {document['seed']}"
    table = Table("", *document["parts"], title=title, title_justify="left")
    for key in next(iter(document["parts"].values())):
        values = (document["parts"][part][key] for part in document["parts"])
        table.add_row(key.replace("_", " "), *("-" if v is None else str(v) for v in values))
    console.print(table)
    for name, path in document["files"].items():
        console.print(f"{name}: {path}", highlight=False, soft_wrap=True)
