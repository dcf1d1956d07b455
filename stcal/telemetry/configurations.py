"""The sensor configurations that a store has been filled with, so that later commands find them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

from stcal.atomic import write_text
from stcal.config import SensorConfig, config_from_json, config_json
from stcal.errors import ConfigError

FOLDER = "configs"


def record(store: Path, configs: Sequence[SensorConfig]) -> None:
    """Keep the validated configurations; one of the same name is replaced."""
    for config in configs:
        path = store / FOLDER / f"{quote(config.name, safe=' ')}.json"
        content = config_json(config)
        if not (path.exists() and path.read_text(encoding="utf-8") == content):
            write_text(path, content)


def recorded_for(store: Path, sensor_id: str) -> SensorConfig:
    """Return the recorded configuration that applies to a sensor.

    Raises
    ------
    ConfigError
        None applies, or more than one does.
    """
    found = []
    for path in sorted((store / FOLDER).glob("*.json")):
        config = config_from_json(path.read_text(encoding="utf-8"), path)
        if config.applies_to(sensor_id):
            found.append(config)
    if len(found) == 1:
        return found[0]
    what = "no configuration" if not found else "more than one configuration"
    raise ConfigError(
        f"{store}: {what} recorded for sensor {sensor_id}"
        + (f" ({', '.join(c.name for c in found)})" if found else "")
        + "; name one with --config"
    )
