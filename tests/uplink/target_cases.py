"""Upload targets and calibrations for the tests of the tables; the numbers mean nothing."""

from __future__ import annotations

import copy
import json
import tomllib
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from stcal.calibration import Calibration
from stcal.cameras import CAMERAS, Camera
from stcal.uplink.target import Target, load_target

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "configs" / "targets" / "st16_cfs.toml"
GOLDEN = Path(__file__).parent / "golden"
PARAMETERS = (0.01601234567, 980.123, 1290.456, -1.2345e8, 1234.5, 1e-3, -2.5e-3, 1.00012)
# The double nearest to a thousand times the focal length above.
FOCAL_MM = float(1000 * Decimal(PARAMETERS[0]))
TURN = (1e-3, -2e-3, 3e-3)


def calibration(**changes: Any) -> Calibration:
    """Return a Wang calibration of ST16-1, serial 7, fitted to data until 2026-01-05 noon."""
    camera = Camera(CAMERAS["wang"], 1944, 2592, 2.2e-6, np.array(PARAMETERS))
    values: dict[str, Any] = {
        "sensor_id": "ST16-1",
        "serial": 7,
        "c_sd": Rotation.from_rotvec(TURN).as_matrix(),
        "provenance": {"from": "2026-01-05T00:00:00.000Z", "to": "2026-01-05T12:00:00.250Z"},
    }
    names = camera.parameter_names
    vector = [changes.pop(k, v) for k, v in zip(names, PARAMETERS, strict=True)]
    values["camera"] = camera.with_parameters(np.array(vector))
    return Calibration(**{**values, **changes})


def example() -> Target:
    return load_target(EXAMPLE)


def example_document() -> dict[str, Any]:
    """Return the example's TOML as plain data, to be changed."""
    return copy.deepcopy(tomllib.loads(EXAMPLE.read_text()))


def as_target(document: dict[str, Any], folder: Path | None = None) -> Target:
    """Validate a changed document, without a file where no folder is given."""
    if folder is None:
        return Target.model_validate(document)
    path = folder / "target.toml"
    path.write_text(toml(document))
    return load_target(path)


def toml(document: dict[str, Any]) -> str:
    """Write what an upload target needs of TOML."""
    lines = [f"{k} = {_value(v)}" for k, v in document.items() if not _is_table(v)]
    for name, section in document.items():
        if isinstance(section, dict):
            lines += [f"[{name}]", *(f"{k} = {_value(v)}" for k, v in section.items())]
        elif _is_table(section):
            for item in section:
                lines += [f"[[{name}]]", *(f"{k} = {_value(v)}" for k, v in item.items())]
    return "\n".join(lines) + "\n"


def _is_table(value: Any) -> bool:
    return isinstance(value, dict) or (
        isinstance(value, list) and bool(value) and isinstance(value[0], dict)
    )


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f'"{k}" = {_value(v)}' for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_value, value)) + "]"
    return json.dumps(value)
