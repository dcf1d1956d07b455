"""Reading scenario files with every error at once, and changing scenarios for studies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import ValidationError

from stcal.config import SensorConfig, load_config, path_beside
from stcal.errors import ConfigError
from stcal.reading import read_toml
from stcal.simulate.scenario import PARTS, Scenario, cross_problems


def load_scenario(path: Path) -> Scenario:
    """Read and validate a scenario file; ``sensor`` names the configuration relative to it.

    Raises
    ------
    ConfigError
        Naming the file and every error in it and in the sensor's configuration.
    """
    document = read_toml(path)
    problems: list[str] = []
    sensor = _sensor(document.get("sensor"), path, problems)
    if sensor is not None:
        document["sensor"] = sensor
    try:
        scenario = Scenario.model_validate(document)
    except ValidationError as error:
        problems += _lines(error, sensor is None)
        # The check across sections runs in pydantic only when every section is right by itself.
        if sensor is not None and not any(item["loc"] == () for item in error.errors()):
            problems += cross_problems(document, sensor)
        raise ConfigError(f"{path}:\n" + "\n".join(f"  {line}" for line in problems)) from None
    return scenario


def _sensor(name: Any, file: Path, problems: list[str]) -> SensorConfig | None:
    if not isinstance(name, str):
        problems.append("sensor: the path of the sensor's configuration is missing or not text")
        return None
    try:
        return load_config(path_beside(file, name, "sensor"))
    except ConfigError as error:
        problems.append(f"sensor: {error}")
        return None


def _lines(error: ValidationError, without_sensor: bool) -> list[str]:
    return [
        f"{'.'.join(str(part) for part in item['loc']) or 'scenario'}: {item['msg']}"
        for item in error.errors()
        if not (without_sensor and item["loc"][:1] == ("sensor",))
    ]


def scenario_with(scenario: Scenario, **changes: Any) -> Scenario:
    """Return the scenario with changed fields, validated anew; for studies.

    A key names the field by its path, with ``__`` between the steps:
    ``scenario_with(s, noise__sd_px=0.2, calibration__segments__0__frames=50)``.

    Raises
    ------
    ConfigError
        Listing every error that the changes bring.
    KeyError, IndexError
        When a path leads to no section.
    """
    document = scenario.model_dump(by_alias=True, exclude={"sensor"})
    document["sensor"] = scenario.sensor
    for part in PARTS:
        document[part]["segments"] = list(document[part]["segments"])
    document["camera"]["drift"]["steps"] = list(document["camera"]["drift"]["steps"])
    for key, value in changes.items():
        *steps, last = key.split("__")
        place: Any = document
        for step in steps:
            place = place[int(step) if isinstance(place, list) else step]
        place[int(last) if isinstance(place, list) else last] = value
    try:
        return Scenario.model_validate(document)
    except ValidationError as error:
        raise ConfigError("scenario:\n  " + "\n  ".join(_lines(error, False))) from None


def with_frames(scenario: Scenario, part: str, frames: int) -> Scenario:
    """Return the scenario with so many frames in a part: segments cut, or the last one longer.

    Raises
    ------
    ConfigError
        When the longer part brings an error.
    """
    segments = []
    left = frames
    for segment in scenario.part(part).segments:
        taken = min(segment.frames, left)
        if taken:
            segments.append(segment.model_copy(update={"frames": taken}))
        left -= taken
    if left:
        segments[-1] = segments[-1].model_copy(update={"frames": segments[-1].frames + left})
    return scenario_with(scenario, **{f"{part}__segments": segments})
