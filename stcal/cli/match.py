"""``stcal match``: identify the stars of stored telemetry with a calibration."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stcal.cli.inputs import MATCHING, OUT, Selection, Workforce, read_inputs, store_options
from stcal.cli.output import emit, progress, watched
from stcal.cli.paths import own_folder

if TYPE_CHECKING:
    from rich.console import Console


@click.command(name="match")
@click.option("--calibration", required=True, type=click.Path(path_type=Path), help="Calibration.")
@MATCHING
@OUT
@store_options
def command(
    calibration: Path,
    matching: str,
    out: Path,
    selection: Selection,
    workforce: Workforce,
    as_json: bool,
) -> None:
    """Identify stars and solve attitudes.

    Writes matches.parquet (one row per star of every exposure) and attitudes.parquet (one row per
    frame: the quaternion of its better exposure) into --out.
    """
    from stcal.calibration import load
    from stcal.pipeline.fit import check_calibration
    from stcal.telemetry.matches import MakeTables, summary, write_tables

    own_folder(out)
    chosen = load(calibration)
    with workforce.map() as mapper, progress(f"match {selection.sensor}") as bar:
        shown = watched(mapper, bar)
        inputs = read_inputs(selection, shown)
        check_calibration(chosen, inputs.matcher.config, selection.sensor)
        parts = shown(MakeTables(chosen, inputs.matcher, matching), inputs.fragments)
        counts = write_tables(parts, out / "matches.parquet", out / "attitudes.parquet")
    document = {"sensor_id": selection.sensor, "matching": matching} | summary(counts)
    emit(document, as_json, lambda console: _table(document, console))


def _table(document: dict[str, Any], console: Console) -> None:
    from rich.table import Table

    table = Table(title=f"{document['sensor_id']}: {document['matching']}")
    table.add_column("Quantity")
    table.add_column("Value", justify="right")
    for key in (
        "frames",
        "frames_solved",
        "exposures",
        "exposures_solved",
        "stars",
        "matched_stars",
    ):
        table.add_row(key.replace("_", " "), str(document[key]))
    for reason, count in document["unsolved"].items():
        table.add_row(f"unsolved: {reason}", str(count))
    rms = document["rms_residual_urad"]
    table.add_row("RMS residual, urad", "-" if rms is None else f"{rms:.1f}")
    console.print(table)
