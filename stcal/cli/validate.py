"""``stcal validate``: compare two calibrations on held-out telemetry."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stcal.cli.inputs import MATCHING, OUT, Selection, Workforce, read_inputs, store_options
from stcal.cli.output import conclude, progress, watched, write_documents
from stcal.cli.paths import own_folder

if TYPE_CHECKING:
    from rich.console import Console


@click.command(name="validate")
@click.option("--baseline", required=True, type=click.Path(path_type=Path), help="Old calibration.")
@click.option("--candidate", required=True, type=click.Path(path_type=Path), help="New one.")
@MATCHING
@OUT
@store_options
def command(
    baseline: Path,
    candidate: Path,
    matching: str,
    out: Path,
    selection: Selection,
    workforce: Workforce,
    as_json: bool,
) -> None:
    """Compare availability, matched stars and common-pair RMS of two calibrations.

    Writes validation.json and report.html into --out; a candidate that is worse than the baseline
    with confidence ends with exit code 4.
    """
    from stcal.calibration import load, sha256_of
    from stcal.pipeline.validate import validate

    own_folder(out)
    old, new = load(baseline), load(candidate)
    hashes = {"baseline": sha256_of(baseline), "candidate": sha256_of(candidate)}
    label = f"validate {selection.sensor}"
    with workforce.map() as mapper, progress(label) as bar:
        shown = watched(mapper, bar)
        inputs = read_inputs(selection, shown)
        document = validate(
            inputs.fragments, old, new, inputs.matcher, inputs.provenance | hashes, matching, shown
        )
    write_documents(document, out / "validation.json", out / "report.html")
    conclude(document, as_json, lambda console: _tables(document, console))


def _tables(document: dict[str, Any], console: Console) -> None:
    from stcal.report.tables import validation_tables

    validation_tables(document, console)
