"""The file that makes a folder a store, with the version of its layout."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from stcal import atomic
from stcal.errors import InputError
from stcal.reading import read_json_object
from stcal.telemetry import parquet
from stcal.telemetry.places import Place, Remote

SCHEMA = "stcal.store"
VERSION = 1
MARKER = "store.json"


def check(root: Place) -> None:
    """Refuse what is no store, or a newer stcal's.

    Raises
    ------
    InputError
        Naming the folder, or its marker when that is wrong.
    """
    if not is_there(root):
        missing = f"{MARKER}, or its bucket," if isinstance(root, Remote) else MARKER
        raise InputError(f"{root}: no stcal store here ({missing} is missing)")
    _check_content(root / MARKER)


def is_there(root: Place) -> bool:
    """Whether a folder is marked as a store.

    Raises
    ------
    InputError
        It cannot be told.
    """
    marker = root / MARKER
    if isinstance(marker, Remote):
        return marker.exists()
    try:
        marker.stat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError as error:
        raise InputError(f"{marker}: cannot be read: {error.strerror}") from None
    return True


def create(root: Path) -> None:
    """Make an empty store in an empty folder, which is made where there is none.

    Raises
    ------
    InputError
        Naming the folder: it holds something else, or cannot be made.
    """
    if root.exists() and not root.is_dir():
        raise InputError(f"{root}: is not a folder")
    filled = root.is_dir() and any(not child.name.startswith(".") for child in root.iterdir())
    if filled and not is_there(root):  # another process may just have made the store
        raise InputError(f"{root}: is neither a store nor empty; name another folder")
    document: dict[str, Any] = {"schema": SCHEMA, "version": VERSION}
    parquet.make_folder(root)
    try:
        atomic.write_text(root / MARKER, json.dumps(document) + "\n")
    except FileNotFoundError:
        if not is_there(root):  # else another one made it, and cleared away what this one wrote
            raise


def _check_content(marker: Place) -> None:
    document = read_json_object(marker)
    schema, version = document.get("schema"), document.get("version")
    if schema != SCHEMA:
        raise InputError(f"{marker}: not the marker of a store: schema {schema!r}, not {SCHEMA!r}")
    if type(version) is not int or version < 1:  # true is an int too
        raise InputError(f"{marker}: store version {version!r} is not a version")
    if version > VERSION:
        raise InputError(
            f"{marker}: written with store version {version}, this stcal reads up to {VERSION}; "
            "use a newer stcal"
        )
