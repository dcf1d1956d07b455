"""What several commands read: options, the store's frames, configuration and catalogue."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from stcal.config import SensorConfig
    from stcal.execution import OrderedMap
    from stcal.frames import FrameBatch
    from stcal.matching import Matcher
    from stcal.telemetry.fragments import Fragment
    from stcal.telemetry.places import Place
    from stcal.telemetry.store import Store

F = TypeVar("F", bound=Callable[..., Any])


class StorePlace(click.Path):
    """The folder of a store, or the URL of one that is only read."""

    def __init__(self, written: bool = False) -> None:
        """Refuse URLs if the store is ``written``."""
        super().__init__()
        self.written = written

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the place; raises InputError for a URL that no store is read from."""
        from stcal.telemetry.places import local_folder, place_of

        place = place_of(str(value))
        return local_folder(place) if self.written else place


JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
STORE = click.option(
    "--store",
    required=True,
    type=StorePlace(),
    help="Folder of the Parquet store, or a URL such as s3://bucket/store.",
)
SENSOR = click.option("--sensor", required=True, help="The sensor's name, e.g. ST16-1.")
OUT = click.option(
    "--out", required=True, type=click.Path(path_type=Path, file_okay=False), help="Output folder."
)
CONFIG = click.option(
    "--config",
    type=click.Path(path_type=Path),
    help="Sensor configuration; the one that ingest recorded in the store if not given.",
)
WORKERS = click.option(
    "--workers",
    type=click.IntRange(1, 256),
    default=lambda: min(os.cpu_count() or 1, 4),
    help="Workers; the processor's cores up to 4 if not given. The result is the same.",
)
SCHEDULER = click.option(
    "--scheduler",
    "scheduler_name",
    default="threads",
    show_default=True,
    metavar="NAME",
    help="serial, threads, processes, or the address of a Dask scheduler such as tcp://host:8786.",
)
MATCHING = click.option(
    "--matching",
    type=click.Choice(["lost-in-space", "guided"]),
    default="lost-in-space",
    show_default=True,
    help="How the stars are identified.",
)
FROM = click.option("--from", "start", help="Use frames from this UTC time on.")
TO = click.option("--to", "stop", help="Use frames before this UTC time.")


@dataclass(frozen=True)
class Selection:
    """Which frames a command reads: one sensor's, of a time range, from a store."""

    store: Place
    sensor: str
    config: Path | None
    start: str | None
    stop: str | None


@dataclass(frozen=True)
class Workforce:
    """How a command's work is scheduled; the result doesn't depend on it."""

    workers: int
    scheduler: str

    def map(self) -> AbstractContextManager[OrderedMap]:
        """Open the ordered map."""
        from stcal.execution import scheduler

        return scheduler(self.workers, self.scheduler)


def workforce_options(function: F) -> F:
    """Give a command ``--workers`` and ``--scheduler`` as a :class:`Workforce`."""

    @wraps(function)
    def command(workers: int, scheduler_name: str, **others: Any) -> Any:
        return function(workforce=Workforce(workers, scheduler_name), **others)

    for option in (SCHEDULER, WORKERS):
        command = option(command)
    return command  # type: ignore[return-value]


def store_options(function: F) -> F:
    """Give a command ``--json``, a :class:`Selection` and a :class:`Workforce`."""

    @wraps(function)
    def command(
        store: Place,
        sensor: str,
        config: Path | None,
        start: str | None,
        stop: str | None,
        **others: Any,
    ) -> Any:
        return function(selection=Selection(store, sensor, config, start, stop), **others)

    command = workforce_options(command)
    for option in (JSON, TO, FROM, CONFIG, SENSOR, STORE):
        command = option(command)
    return command  # type: ignore[return-value]


@dataclass(frozen=True)
class Inputs:
    """One sensor's frames, not yet read, with what is needed to process them."""

    fragments: list[Fragment]
    matcher: Matcher
    provenance: dict[str, Any]

    @property
    def batches(self) -> list[FrameBatch]:
        """All frames, for work that needs them in memory."""
        return [fragment.read() for fragment in self.fragments]


def read_inputs(selection: Selection, mapper: OrderedMap | None = None) -> Inputs:
    """Find a sensor's frames of a time range, its configuration and its catalogue."""
    from stcal.catalog.catalogue import catalogue_sha256, select
    from stcal.config import config_sha256
    from stcal.errors import ConfigError, UsageError
    from stcal.execution import serial
    from stcal.matching import Matcher
    from stcal.pipeline.describe import span_of
    from stcal.telemetry.fragments import fragments_sha256
    from stcal.telemetry.store import Store
    from stcal.version import __version__

    limits = parse_time(selection.start, "--from"), parse_time(selection.stop, "--to")
    if limits[0] is not None and limits[1] is not None and limits[0] >= limits[1]:
        raise UsageError(f"--from {selection.start} is not before --to {selection.stop}")
    opened, sensor = Store.open(selection.store), selection.sensor
    fragments = opened.fragments(sensor, *limits)
    settings = load_settings(opened, sensor, selection.config)
    section = settings.catalogue
    full = load_catalogue(settings)
    faintest = float(full.magnitude.max())
    if section.limiting_magnitude > faintest + 0.05:
        raise ConfigError(
            f"configuration {settings.name!r}: limiting_magnitude {section.limiting_magnitude} is "
            f"beyond the catalogue, which ends at {faintest:.2f}"
        )
    chosen = select(full, section.limiting_magnitude, section.merge_separation_arcsec)
    provenance = {
        "telemetry_sha256": fragments_sha256(sensor, fragments, mapper or serial),
        "catalogue_sha256": catalogue_sha256(full),
        "config_sha256": config_sha256(settings),
        "software": f"stcal {__version__}",
        **span_of(fragments),
    }
    return Inputs(fragments, Matcher(chosen, settings), provenance)


def load_catalogue(settings: SensorConfig) -> Any:
    """Return the catalogue that a configuration names, else the bundled one."""
    from stcal.catalog.catalogue import load, load_bundled

    path = settings.catalogue.path
    return load_bundled() if path is None else load(Path(path))


def load_settings(opened: Store, sensor: str, config: Path | None) -> SensorConfig:
    """Return the configuration given, or the one that the store has recorded for the sensor."""
    from stcal.config import load_config
    from stcal.errors import ConfigError
    from stcal.telemetry.configurations import recorded_for

    if config is None:
        return recorded_for(opened.root, sensor)
    settings = load_config(config)
    if not settings.applies_to(sensor):
        raise ConfigError(
            f"{config}: describes {', '.join(settings.sensor_ids)}, not sensor {sensor}"
        )
    return settings


def parse_time(text: str | None, option: str) -> int | None:
    """Return TAI ns of a UTC option; a plain date means its first moment."""
    from stcal.errors import UsageError
    from stcal.times import parse_utc

    if text is None:
        return None
    full = text if "T" in text else f"{text.removesuffix('Z')}T00:00:00Z"
    try:
        return parse_utc(full)
    except ValueError:
        raise UsageError(
            f"{option} {text!r} is not a UTC time such as 2026-01-05T12:00:00Z or 2026-01-05"
        ) from None
