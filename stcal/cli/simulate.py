"""``stcal simulate``: telemetry of a simulated sensor, with its truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stcal.cli.output import emit, progress
from stcal.cli.paths import output_folder

if TYPE_CHECKING:
    from rich.console import Console


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
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def command(
    scenario_file: Path,
    out: Path,
    seed: int,
    truth_columns: bool,
    layout_file: Path | None,
    as_json: bool,
) -> None:
    """Make telemetry of a simulated sensor, as SCENARIO.toml describes it."""
    from stcal.simulate import load_scenario, simulate
    from stcal.simulate.files import summary, write_packets, write_simulation
    from stcal.telemetry.packet_layout import load_layout

    output_folder(out)
    layout = load_layout(layout_file) if layout_file is not None else None
    scenario = load_scenario(scenario_file)
    with progress(f"Simulating {scenario.sensor_id}", total=2) as bar:
        simulation = simulate(scenario, seed)
        bar.advance(1)
        bar.describe(f"Writing {out}")
        files = write_simulation(simulation, out, truth_columns)
        if layout is not None:
            files |= write_packets(simulation, layout, out)
        bar.advance(1)
    document: dict[str, Any] = {
        "sensor_id": scenario.sensor_id,
        "scenario": str(scenario_file),
        "seed": seed,
        "files": {name: str(path) for name, path in files.items()},
        "parts": summary(simulation),
    }
    emit(document, as_json, lambda console: _table(document, console))


def _table(document: dict[str, Any], console: Console) -> None:
    from rich.table import Table

    title = f"{document['sensor_id']}, seed {document['seed']}"
    table = Table("", *document["parts"], title=title, title_justify="left")
    for key in next(iter(document["parts"].values())):
        values = (document["parts"][part][key] for part in document["parts"])
        table.add_row(key.replace("_", " "), *("-" if v is None else f"{v:g}" for v in values))
    console.print(table)
    for name, path in document["files"].items():
        console.print(f"{name}: {path}", highlight=False, soft_wrap=True)
