"""``stcal align``: estimate how a calibrated sensor sits in the spacecraft's body."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stcal.cli.inputs import MATCHING, OUT, Selection, Workforce, read_inputs, store_options
from stcal.cli.output import conclude, progress, write_documents
from stcal.cli.paths import own_folder
from stcal.errors import InputError, UsageError

if TYPE_CHECKING:
    from rich.console import Console

    from stcal.execution import OrderedMap
    from stcal.pipeline.body_attitude import BodyAttitudes

DOCUMENT, REPORT = "alignment.json", "report.html"


@dataclass(frozen=True)
class BodySource:
    """Where the command line says that the body's attitude comes from."""

    record: Path | None
    sensor: str | None
    calibration: Path | None

    def check(self, sensor: str) -> None:
        """Refuse anything but one source, other than the sensor itself.

        Raises
        ------
        UsageError
        """
        if (self.record is None) == (self.sensor is None):
            raise UsageError(
                "say where the body's attitude comes from: --body ATTITUDES or --body-sensor SENSOR"
            )
        if self.calibration is not None and self.sensor is None:
            raise UsageError("--body-calibration belongs to --body-sensor")
        if self.sensor == sensor:
            raise UsageError(f"--body-sensor {sensor} is the sensor that is to be aligned")


def _number(context: click.Context, parameter: click.Parameter, value: float) -> float:
    """Refuse NaN, which passes through every range."""
    if math.isnan(value):
        raise click.BadParameter("not a number")
    return value


@click.command(name="align")
@click.option(
    "--calibration", required=True, type=click.Path(path_type=Path),
    help="The sensor's calibration, as fit writes it.",
)  # fmt: skip
@click.option(
    "--body",
    type=click.Path(path_type=Path),
    help="CSV of the body's attitude: time_utc, q_x, q_y, q_z, q_w, and sd_urad if known.",
)
@click.option("--body-sensor", help="Another sensor of the store: its frame is the body's.")
@click.option(
    "--body-calibration",
    type=click.Path(path_type=Path),
    help="Its calibration, to solve its attitudes with; its telemetered quaternions without.",
)
@click.option(
    "--attitude-sd-urad",
    type=click.FloatRange(0.0, 1e6),
    default=0.0,
    callback=_number,
    show_default=True,
    help="Noise of the body's attitude per axis, beside what its source states.",
)
@click.option(
    "--maximum-gap-s",
    type=click.FloatRange(0.0, 86_400.0),
    default=10.0,
    callback=_number,
    show_default=True,
    help="Longest time between two attitudes to interpolate over.",
)
@click.option(
    "--method",
    type=click.Choice(["linear", "multiplicative"]),
    default="multiplicative",
    show_default=True,
    help="The filter whose estimate is the result; both are run.",
)
@MATCHING
@OUT
@store_options
def command(
    calibration: Path,
    body: Path | None,
    body_sensor: str | None,
    body_calibration: Path | None,
    attitude_sd_urad: float,
    maximum_gap_s: float,
    method: str,
    matching: str,
    out: Path,
    selection: Selection,
    workforce: Workforce,
    as_json: bool,
) -> None:
    """Estimate the rotation from the spacecraft's body frame to the sensor's frame.

    The second stage after any fit: the stars seen with the fitted calibration against the attitude
    of the body, from a record or from another sensor.  Writes alignment.json and report.html into
    --out; an alignment that a gate refuses has no result and ends with exit code 4.
    """
    from stcal.calibration import load, sha256_of
    from stcal.pipeline.align import AlignOptions, align

    source = BodySource(body, body_sensor, body_calibration)
    source.check(selection.sensor)
    options = AlignOptions(method, matching, attitude_sd_urad, maximum_gap_s)
    own_folder(out)
    chosen = load(calibration)
    inputs = read_inputs(selection)
    provenance = inputs.provenance | {"calibration_sha256": sha256_of(calibration)}
    with workforce.map() as mapper, progress(f"align {selection.sensor}"):
        attitudes = _attitudes(source, selection, matching, mapper)
        document = align(
            inputs.batches, chosen, attitudes, inputs.matcher, provenance, options, mapper
        )
    write_documents(document, out / DOCUMENT, out / REPORT)
    conclude(document, as_json, lambda console: _tables(document, console))


def _attitudes(
    source: BodySource, selection: Selection, matching: str, mapper: OrderedMap
) -> BodyAttitudes:
    """Read the body's attitudes from the source that was given."""
    if source.record is not None:
        from stcal.telemetry.attitudes import read_attitudes

        return read_attitudes(source.record)
    from stcal.calibration import load, sha256_of
    from stcal.pipeline.body_attitude import telemetered_attitudes
    from stcal.pipeline.pairing import first_exposures, solved_attitudes

    other = Selection(selection.store, str(source.sensor), None, selection.start, selection.stop)
    inputs = read_inputs(other)
    told = {"sensor": source.sensor, "telemetry_sha256": inputs.provenance["telemetry_sha256"]}
    if source.calibration is None:
        found = telemetered_attitudes(inputs.batches, told | {"attitudes": "telemetered"})
    else:
        calibration = load(source.calibration)
        stars = first_exposures(inputs.batches, calibration, inputs.matcher, matching, mapper)
        told |= {"attitudes": "solved", "calibration_sha256": sha256_of(source.calibration)}
        found = solved_attitudes(stars, told)
    if len(found.t_tai_ns) == 0:
        raise InputError(f"{selection.store}: no frame of {source.sensor} has an attitude")
    return found


def _tables(document: dict[str, Any], console: Console) -> None:
    from stcal.report.align_report import alignment_tables

    alignment_tables(document, console)
