"""The sensor configurations that a store has been filled with, so that later commands find them."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from stcal.atomic import write_bytes, write_text
from stcal.config import SensorConfig, config_from_json, config_json
from stcal.errors import ConfigError, InputError
from stcal.reading import MAXIMUM_JSON_BYTES, read_bytes
from stcal.telemetry.parquet import make_folder
from stcal.telemetry.places import Place, listed

if TYPE_CHECKING:
    from stcal.telemetry.packet_layout import PacketLayout

FOLDER = "configs"
LAYOUTS = "layouts"


def record(store: Path, configs: Sequence[SensorConfig]) -> None:
    """Keep the validated configurations; one of the same name is replaced."""
    for config in configs:
        path = store / FOLDER / f"{quote(config.name, safe=' ')}.json"
        content = config_json(config)
        if not (path.exists() and _read(path) == content):
            make_folder(path.parent)
            write_text(path, content)


def recorded(store: Place) -> list[SensorConfig]:
    """Return every recorded configuration, in the order of their names.

    Raises
    ------
    ConfigError
        One is damaged.
    """
    paths = listed(store / FOLDER, "*.json")
    return [config_from_json(_read(path), str(path)) for path in paths]


def record_layout(store: Path, layout: PacketLayout) -> None:
    """Keep a packet layout's file under its hash, so that all that were ever used are there."""
    digest = hashlib.sha256(layout.source).hexdigest()
    path = store / LAYOUTS / f"{digest}.toml"
    if not path.exists():
        make_folder(path.parent)
        write_bytes(path, layout.source)


def recorded_for(store: Place, sensor_id: str) -> SensorConfig:
    """Return the recorded configuration that applies to a sensor.

    Raises
    ------
    ConfigError
        None applies, or more than one does, or one is damaged.
    """
    found = [config for config in recorded(store) if config.applies_to(sensor_id)]
    if len(found) == 1:
        return found[0]
    what = "no configuration" if not found else "more than one configuration"
    raise ConfigError(
        f"{store}: {what} recorded for sensor {sensor_id}"
        + (f" ({', '.join(c.name for c in found)})" if found else "")
        + "; name one with --config"
    )


def _read(path: Place) -> str:
    try:
        return read_bytes(path, MAXIMUM_JSON_BYTES).decode("utf-8")
    except InputError as error:
        raise ConfigError(str(error)) from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8: {error}") from None
