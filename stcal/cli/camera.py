"""``stcal camera convert``: a calibration in another camera model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stcal.cli.inputs import JSON
from stcal.cli.output import conclude
from stcal.cli.paths import output_file
from stcal.errors import UsageError

if TYPE_CHECKING:
    from rich.console import Console

_FILE = click.Path(path_type=Path, dir_okay=False)


@click.group(name="camera")
def command() -> None:
    """Convert calibrations between camera models."""


@command.command()
@click.argument("calibration", type=_FILE)
@click.option("--to", "model", required=True, help="Camera model, e.g. wang.")
@click.option("--out", required=True, type=_FILE, help="The calibration file to write.")
@click.option("--report", type=_FILE, help="HTML report with the error over the detector.")
@click.option(
    "--maximum-urad",
    type=click.FloatRange(min=0.0),
    help="Refuse a larger error of a direction; no limit if not given.",
)
@JSON
def convert(
    calibration: Path,
    model: str,
    out: Path,
    report: Path | None,
    maximum_urad: float | None,
    as_json: bool,
) -> None:
    """Write CALIBRATION in another camera model, by least squares over the detector.

    The alignment takes up a turn of the detector's frame, so that directions in the sensor's frame
    agree.  A refused conversion (exit code 4) writes no calibration.
    """
    from stcal.calibration import load, save, sha256_of
    from stcal.cameras import CAMERAS
    from stcal.pipeline.conversion import convert_calibration
    from stcal.report.html import write_report

    if model not in CAMERAS:
        raise UsageError(f"--to {model!r} is not a camera model; known: {', '.join(CAMERAS)}")
    old = load(calibration)
    if out.exists() and out.samefile(calibration):
        raise UsageError(f"--out {out} is the file to convert, which its provenance will name")
    output_file(out)
    result = convert_calibration(old, CAMERAS[model], sha256_of(calibration), maximum_urad)
    if report is not None:
        write_report(result.document, output_file(report))
    if result.calibration is not None:
        save(result.calibration, out)
    conclude(result.document, as_json, lambda console: _tables(result.document, console))


def _tables(document: dict[str, Any], console: Console) -> None:
    from stcal.report.tables import conversion_tables

    conversion_tables(document, console)
