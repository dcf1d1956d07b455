"""Names that come from outside: a sensor's as its folder's, a file's as text."""

from __future__ import annotations

import os
from pathlib import Path
from urllib.parse import quote

from stcal.errors import InputError

# File systems allow 255 bytes; the rest is left for endings.
MAXIMUM_FOLDER_BYTES = 200
_SHOWN = 64


def sensor_folder(sensor_id: str) -> str:
    """Return the folder's name of a sensor; no character of it can leave the folder.

    Raises
    ------
    InputError
        The name is not text, or the folder's would be too long for a file system.
    """
    shown = sensor_id if len(sensor_id) <= _SHOWN else sensor_id[:_SHOWN] + "..."
    try:
        folder = "sensor=" + quote(sensor_id, safe="")
    except UnicodeEncodeError:
        raise InputError(f"sensor {shown!r}: the name is not UTF-8 text") from None
    if len(folder) > MAXIMUM_FOLDER_BYTES:
        raise InputError(
            f"sensor {shown!r}: the name takes {len(folder)} bytes as a folder's, "
            f"the most is {MAXIMUM_FOLDER_BYTES}"
        )
    return folder


def printable(text: str | Path) -> str:
    """Return a file's name, or a message with one, with bytes that are not UTF-8 as escapes."""
    return os.fspath(text).encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
