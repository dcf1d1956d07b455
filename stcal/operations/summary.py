"""The document of a recalibration, schema ``stcal.fleet/1``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from stcal.calibration import sha256_of
from stcal.errors import InputError
from stcal.operations.plan import PlanFile
from stcal.operations.run import FleetRun, SensorRun
from stcal.operations.steps import VALIDATION
from stcal.reading import read_json_object
from stcal.report.document import FLEET_SCHEMA
from stcal.version import __version__


def fleet_document(file: PlanFile, run: FleetRun) -> dict[str, Any]:
    """Return what was done, in numbers: a row per sensor, and the worst exit code."""
    return {
        "schema": FLEET_SCHEMA,
        "software": f"stcal {__version__}",
        "plan": str(file.path),
        "plan_sha256": sha256_of(file.path),
        "exit_code": run.exit_code,
        "ingest": None if run.ingest is None else asdict(run.ingest),
        "sensors": [_sensor(file, one) for one in run.sensors],
    }


def _sensor(file: PlanFile, run: SensorRun) -> dict[str, Any]:
    folder = file.out / run.sensor.sensor_id
    names = {outcome.name for outcome in run.outcomes}
    validation = _read(folder / "validation" / VALIDATION) if "validate" in names else {}
    report = folder / "report.html"
    uploads = sorted(folder.glob("uplink/serial-*")) if run.state == "built" else []
    return {
        "sensor_id": run.sensor.sensor_id,
        "state": run.state,
        "exit_code": run.exit_code,
        "message": run.outcomes[-1].message if run.outcomes else "",
        "steps": [asdict(outcome) for outcome in run.outcomes],
        "availability": validation.get("availability"),
        "matched_star_ratio": validation.get("matched_star_ratio"),
        "common_pair_rms_urad": validation.get("common_pair_rms_urad"),
        "upload": _inside(file, uploads[-1]) if uploads else None,
        "report": _inside(file, report) if report.exists() else None,
    }


def _inside(file: PlanFile, path: Path) -> str:
    return path.relative_to(file.out).as_posix()


def _read(path: Path) -> dict[str, Any]:
    try:
        return read_json_object(path)
    except InputError:
        return {}
