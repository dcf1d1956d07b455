"""Reading the text files that users name: every failure is one error that names the file."""

from __future__ import annotations

import hashlib
import json
import re
import tomllib
from pathlib import Path
from typing import Any, BinaryIO, Literal, Protocol

from stcal.errors import ConfigError, InputError

# No file of stcal's comes near; a larger one would only fill the memory.
MAXIMUM_TOML_BYTES = 1 << 20
MAXIMUM_JSON_BYTES = 64 << 20
# tomllib's time grows with the square of a dotted key's parts: 50 000 of them take a minute.
_MOST_KEY_PARTS = 32
_BETWEEN_KEYS, _KEY_DOT = re.compile(r"[=,{}\[\]]"), re.compile(r"(?<!\.)\.(?!\.)")


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
        content = read_bytes(path, MAXIMUM_TOML_BYTES)
    except InputError as error:
        raise ConfigError(str(error)) from None
    return parse_toml(content, str(path))


def parse_toml(content: bytes, where: str) -> dict[str, Any]:
    """Return the content of a TOML file's bytes; ``where`` names them in errors.

    Raises
    ------
    ConfigError
        They are not TOML, or hold a key of more parts than any key of stcal's.
    """
    try:
        text = content.decode("utf-8")
        _check_keys(text)
        return tomllib.loads(text)
    except (RecursionError, ValueError) as error:  # a ValueError: a number of thousands of digits
        raise ConfigError(f"{where}: not TOML: {error}") from None


def _check_keys(text: str) -> None:
    for number, line in enumerate(text.split("\n"), 1):
        # Most lines have few dots; in the others, those of one key count.
        if line.count(".") >= _MOST_KEY_PARTS and any(
            len(_KEY_DOT.findall(piece)) >= _MOST_KEY_PARTS for piece in _BETWEEN_KEYS.split(line)
        ):
            raise ValueError(f"line {number}: a key of more than {_MOST_KEY_PARTS} parts")


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


def document_sha256(document: dict[str, Any]) -> str:
    """Return the hash of everything in a document but its ``sha256``, however it is laid out."""
    content = {key: value for key, value in document.items() if key != "sha256"}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
