"""The sensor configurations that a store has been filled with, so that later commands find them.

Each carries the hash of its content, since a digit that a disk has changed is still JSON.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from stcal.atomic import write_bytes, write_text
from stcal.calibration import canonical_json
from stcal.config import SensorConfig, config_from_json, config_json
from stcal.errors import ConfigError, InputError
from stcal.reading import document_sha256, read_json_object
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
        document = json.loads(config_json(config))
        document["sha256"] = document_sha256(document)
        content = canonical_json(document)
        if not _holds(path, content.encode()):
            make_folder(path.parent)
            write_text(path, content)


def recorded(store: Place) -> list[SensorConfig]:
    """Return every recorded configuration, in the order of their names.

    Raises
    ------
    ConfigError
        One is damaged.
    """
    return [_recorded(path) for path in listed(store / FOLDER, "*.json")]


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


def _holds(path: Path, content: bytes) -> bool:
    try:
        return path.read_bytes() == content
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None


def _recorded(path: Place) -> SensorConfig:
    try:
        document = read_json_object(path)
    except InputError as error:
        raise ConfigError(str(error)) from None
    said = document.pop("sha256", None)  # stores of older versions have none
    if said is not None and said != document_sha256(document):
        raise ConfigError(
            f"{path}: damaged: its content does not agree with its sha256; ingest with this "
            "configuration again, or name one with --config"
        )
    return config_from_json(json.dumps(document), str(path))
