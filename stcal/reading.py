"""Reading the text files that users name: every failure is one error that names the file."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any, BinaryIO, Literal, Protocol

from stcal.errors import ConfigError, InputError

# No file of stcal's comes near; a larger one would only fill the memory.
MAXIMUM_TOML_BYTES = 4 << 20
MAXIMUM_JSON_BYTES = 64 << 20


class Readable(Protocol):
    """A file that can be opened: a path, or one of an object store."""

    def open(self, mode: Literal["rb"], /) -> BinaryIO:
        """Open it for reading."""


def read_toml(path: Path) -> dict[str, Any]:
    """Return a TOML file's content.

    Raises
    ------
    ConfigError
        Naming the file: unreadable or not TOML.
    """
    try:
        return tomllib.loads(read_bytes(path, MAXIMUM_TOML_BYTES).decode("utf-8"))
    except InputError as error:
        raise ConfigError(str(error)) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise ConfigError(f"{path}: not TOML: {error}") from None


def read_bytes(path: Readable, maximum: int) -> bytes:
    """Return a file's bytes; also of a pipe, which tells no size beforehand.

    Raises
    ------
    InputError
        Naming the file: unreadable, or longer than ``maximum``.
    """
    try:
        with path.open("rb") as stream:
            content = stream.read(maximum + 1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError:  # a NUL character
        raise InputError(f"{str(path)!r}: is no name of a file") from None
    if len(content) > maximum:
        raise InputError(f"{path}: is longer than {maximum} bytes")
    return content


def read_json_object(path: Readable) -> dict[str, Any]:
    """Return a JSON file's top-level object.

    Raises
    ------
    InputError
        Naming the file: unreadable, not JSON or not an object.
    """
    content = read_bytes(path, MAXIMUM_JSON_BYTES)
    try:
        document = json.loads(content.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not JSON: {error}") from None
    if not isinstance(document, dict):
        raise InputError(f"{path}: the top level is not an object")
    return document
