"""What every decoder yields: telemetry rows as columns of text."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from stcal.frames import Ints
from stcal.telemetry.quarantine import Rejection
from stcal.telemetry.sources import SourceFile


@dataclass(frozen=True)
class RowBlock:
    """Rows of the long form, not yet looked at; a frame's run of rows is never cut.

    Attributes
    ----------
    columns : one Arrow string array of length n for every name in ``columns.COLUMNS``; an empty
        value is null or ``''``
    row : (n,) the line that each row stands on
    run : (n,) index of the run of neighbouring rows that belong to one frame, from 0, without gaps
    raw : the text of row i, for quarantine
    raw_line : the text of the line that row i stands on
    rejected : rows of these lines that could not be read at all
    lines_are_frames : one line gives a whole frame, so that runs are never joined
    truncated_run : the file ends too early, and its last run may lack rows
    """

    columns: dict[str, Any]
    row: Ints
    run: Ints
    raw: Callable[[int], str]
    raw_line: Callable[[int], str]
    rejected: list[Rejection]
    lines_are_frames: bool = False
    truncated_run: bool = False

    def __len__(self) -> int:
        """Return the number of rows n."""
        return len(self.row)


@dataclass(frozen=True)
class Decoder:
    """A telemetry format.

    Attributes
    ----------
    extensions : endings of names, without ``.gz``
    sniff : whether a file that begins with these bytes is of this format
    decode : yields the file's blocks; calls the second argument with what the user should know.
        Raises InputError naming the file when it is not of this format after all
    """

    name: str
    extensions: tuple[str, ...]
    sniff: Callable[[bytes], bool]
    decode: Callable[[SourceFile, Callable[[str], None]], Iterator[RowBlock]]


def text_of(line: bytes) -> str:
    """Return a line as text for quarantine; bytes that are not UTF-8 are written as escapes."""
    return line.rstrip(b"\r\n").decode("utf-8", "backslashreplace")
