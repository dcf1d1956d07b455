"""Checks of output paths before the work, so that a wrong one doesn't cost it."""

from __future__ import annotations

import os
from pathlib import Path

import click

from stcal.atomic import locked
from stcal.errors import InputError


def output_file(path: Path) -> Path:
    """Return the path of a file to write, after a look at whether one can appear there.

    Raises
    ------
    InputError
        Naming the path: it is a folder, or lies below something that is none.
    """
    try:
        if path.is_dir():
            raise InputError(f"{path}: is a folder, not a file to write")
        above = next(parent for parent in path.absolute().parents if parent.exists())
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
    if not above.is_dir():
        raise InputError(f"{path}: cannot be written: {above} is not a folder")
    return path


def output_folder(path: Path) -> Path:
    """Make the folder of a command's output and return it.

    Raises
    ------
    InputError
        Naming the folder and what is wrong with it.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be made: {error.strerror}") from None
    if not os.access(path, os.W_OK):
        raise InputError(f"{path}: not writable")
    return path


def own_folder(path: Path) -> Path:
    """Make the folder of a command's output, held until the command ends.

    Two commands at a time would leave the document of one beside the calibration of the other.

    Raises
    ------
    InputError
        Naming the folder and what is wrong with it, or that another process writes into it.
    """
    output_folder(path)
    try:
        click.get_current_context().with_resource(locked(path))
    except BlockingIOError:
        raise InputError(
            f"{path}: another process is writing into this folder; wait for its end, or name "
            "another folder"
        ) from None
    return path
