"""What every decoder yields: telemetry rows as columns of text, or of values."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from stcal.frames import Ints
from stcal.telemetry.quarantine import Rejection
from stcal.telemetry.sources import SourceFile


@dataclass(frozen=True)
class RowBlock:
    """Rows of the long form, not yet looked at; a frame's run of rows is never cut.

    Attributes
    ----------
    columns : for every name in ``columns.COLUMNS`` an Arrow string array of length n, whose empty
        values are null or ``''``, or a :class:`stcal.telemetry.typed.Typed` column; with
        ``frame`` the columns that are not of the stars may be shorter
    row : (n,) the line that each row stands on
    run : (n,) index of the run of neighbouring rows that belong to one frame, from 0, without gaps
    raw : the bytes of what row i stands in (its line, packet or record) as the source has them
    offset : (n,) where those bytes begin in the decompressed source; -1 where they stand in no
        one place
    rejected : rows of these lines that could not be read at all
    lines_are_frames : one line gives a whole frame, so that runs are never joined
    frames_span_lines : runs are joined although a line is not a row: an exposure a packet
    truncated_run : the file ends too early, and its last run may lack rows
    frame : (n,) where the columns of the frame have each row's values, the same for all rows of a
        run; None where they have a value a row
    """

    columns: dict[str, Any]
    row: Ints
    run: Ints
    raw: Callable[[int], bytes]
    offset: Ints
    rejected: list[Rejection]
    lines_are_frames: bool = False
    frames_span_lines: bool = False
    truncated_run: bool = False
    frame: Ints | None = None

    @cached_property
    def frame_index(self) -> Ints:
        """(n,) where the columns of the frame have each row's values."""
        return np.arange(len(self)) if self.frame is None else self.frame

    def __len__(self) -> int:
        """Return the number of rows n."""
        return len(self.row)


@dataclass(frozen=True)
class Again:
    """How raw bytes that were kept are decoded again.

    Attributes
    ----------
    decode : as a :class:`Decoder` does; the file is ``prefix`` and the pieces, ``separator``
        after the prefix and after every piece
    one_by_one : every piece is a file of its own, since pieces side by side could be taken for one
    show : a piece as text, for formats whose bytes say nothing to a reader
    """

    decode: Callable[[SourceFile, Callable[[str], None]], Iterator[RowBlock]]
    prefix: bytes = b""
    separator: bytes = b""
    one_by_one: bool = False
    show: Callable[[bytes], str] | None = None


def no_context(source: SourceFile) -> bytes:
    """For formats whose records say everything themselves."""
    return b""


@dataclass(frozen=True)
class Decoder:
    """A telemetry format.

    Attributes
    ----------
    extensions : endings of names, without ``.gz``
    sniff : whether a file that begins with these bytes is of this format
    decode : yields the file's blocks; calls the second argument with what the user should know.
        Raises InputError naming the file when it is not of this format after all
    context : what it takes, beside raw bytes of the file, to decode these again
    text : whether the file is UTF-8 text in lines, which is then checked beforehand
    report : when all blocks have come, what there is to say about the file as a whole
    """

    name: str
    extensions: tuple[str, ...]
    sniff: Callable[[bytes], bool]
    decode: Callable[[SourceFile, Callable[[str], None]], Iterator[RowBlock]]
    context: Callable[[SourceFile], bytes] = no_context
    text: bool = True
    report: Callable[[], dict[str, Any]] | None = None
