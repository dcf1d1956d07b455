"""``stcal sensor check``: validate sensor configurations."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stcal.cli.output import emit
from stcal.errors import ConfigError, InputError

if TYPE_CHECKING:
    from rich.console import Console


@click.group(name="sensor")
def command() -> None:
    """Check sensor configurations."""


@command.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def check(files: tuple[Path, ...], as_json: bool) -> None:
    """Validate each FILE and the catalogue that it names; list every error at once."""
    results = [_check(path) for path in files]
    problems = [row["error"] for row in results if row["error"]]
    if problems:
        failure = ConfigError("\n".join(problems))
        failure.document = {"files": results}
        raise failure
    emit({"files": results}, as_json, lambda console: _table(results, console))


def _check(path: Path) -> dict[str, Any]:
    from stcal.config import load_config

    problems = _catalogue_problems(path)
    try:
        config = load_config(path)
    except ConfigError as error:
        problems.insert(0, str(error))
    if problems:
        return {"file": str(path), "valid": False, "error": "\n".join(problems)}
    return {
        "file": str(path),
        "valid": True,
        "error": None,
        "name": config.name,
        "sensor_ids": config.sensor_ids,
        "camera": config.camera.model,
        "detector": [config.detector.rows, config.detector.cols],
    }


def _catalogue_problems(path: Path) -> list[str]:
    """Load the catalogue that a file names, even where the rest of the file is wrong."""
    from stcal.catalog.catalogue import load
    from stcal.config import path_beside
    from stcal.reading import read_toml

    try:
        section = read_toml(path).get("catalogue")
        name = section.get("path") if isinstance(section, dict) else None
        if not isinstance(name, str) or not name or "\0" in name:
            return []  # none named, or load_config says what is wrong with the name
        load(path_beside(path, name, "catalogue.path"))
    except ConfigError:
        return []  # load_config meets it too
    except InputError as error:
        return [f"{path}:\n  catalogue.path: {error}"]
    return []


def _table(results: list[dict[str, Any]], console: Console) -> None:
    from rich.table import Table

    table = Table("File", "Sensor", "Applies to", "Camera", "Detector")
    for row in results:
        rows, cols = row["detector"]
        ids = ", ".join(row["sensor_ids"])
        table.add_row(row["file"], row["name"], ids, row["camera"], f"{rows} x {cols}")
    console.print(table)
