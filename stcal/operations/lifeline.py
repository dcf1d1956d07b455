"""A pipe between a run and its steps, by which a step notices that the run was killed.

The run holds the pipe's one end and never writes.  When it ends, in whatever way, the system closes
that end, and the steps, which read at the other, end too.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread
from typing import Any

_VARIABLE = "STCAL_LIFELINE"


@contextmanager
def lifeline() -> Iterator[dict[str, Any]]:
    """Give the options of ``subprocess.Popen`` for processes that end with this one."""
    theirs, ours = os.pipe()
    try:
        yield {"pass_fds": (theirs,), "env": os.environ | {_VARIABLE: str(theirs)}}
    finally:
        os.close(theirs)
        os.close(ours)


def follow() -> None:
    """End this process as SIGTERM does when the run that started it is gone, if one did."""
    handle = os.environ.pop(_VARIABLE, "")
    if handle.isdecimal():
        Thread(target=_end_after, args=(int(handle),), daemon=True).start()


def _end_after(handle: int) -> None:
    try:
        os.read(handle, 1)
    except OSError:  # no pipe of ours: the variable is somebody else's
        return
    os.kill(os.getpid(), signal.SIGTERM)
