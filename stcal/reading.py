"""Reading the text files that users name: every failure is one error that names the file."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

from stcal.errors import ConfigError, InputError


def read_toml(path: Path) -> dict[str, Any]:
    """Return a TOML file's content.

    Raises
    ------
    ConfigError
        Naming the file: unreadable or not TOML.
    """
    try:
        with path.open("rb") as stream:
            return tomllib.load(stream)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigError(f"{path}: not TOML: {error}") from None


def read_json_object(path: Path) -> dict[str, Any]:
    """Return a JSON file's top-level object.

    Raises
    ------
    InputError
        Naming the file: unreadable, not JSON or not an object.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not JSON: {error}") from None
    if not isinstance(document, dict):
        raise InputError(f"{path}: the top level is not an object")
    return document
