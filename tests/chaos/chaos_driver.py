"""Run stcal in a process of its own, and let something happen the k-th time it touches the disk.

The process is forked, so that a kill is a kill and yet the libraries need not be loaded anew.
"""

from __future__ import annotations

import contextlib
import errno
import io
import json
import os
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

NEVER = 1 << 30
TOUCHES = ("fsync", "replace", "rename", "unlink")
ERRORS = {"ENOSPC": errno.ENOSPC, "EROFS": errno.EROFS, "EACCES": errno.EACCES}
SIGNALS = {"SIGKILL": signal.SIGKILL, "SIGINT": signal.SIGINT, "SIGTERM": signal.SIGTERM}


@dataclass(frozen=True)
class Ended:
    """How a command ended: exit code (or minus the signal), what it told, disk touches seen."""

    code: int
    out: str
    err: str
    touches: int


def stcal(arguments: list[object], fault: str = "", at: int = NEVER, writes: bool = False) -> Ended:
    """Run a command; at its ``at``-th touch of the disk raise an error or send a signal.

    ``writes``: count the writes to files too.
    """
    folder = Path(os.environ["STCAL_CHAOS_TMP"])
    out, err, count = (folder / name for name in ("out", "err", "count"))
    child = os.fork()
    if child == 0:
        code = 1
        try:
            for number, path in ((1, out), (2, err)):
                os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
            sys.stdout, sys.stderr = (os.fdopen(os.dup(k), "w") for k in (1, 2))
            code = _child([str(argument) for argument in arguments], fault, at, writes, count)
            sys.stdout.flush()
            sys.stderr.flush()
        finally:
            os._exit(code)
    _, status = os.waitpid(child, 0)
    touches = int(count.read_text()) if count.exists() else 0
    count.unlink(missing_ok=True)
    return Ended(os.waitstatus_to_exitcode(status), out.read_text(), err.read_text(), touches)


def _child(arguments: list[str], fault: str, at: int, writes: bool, count: Path) -> int:
    from stcal.cli import main

    seen = [0]

    def touched(*names: object) -> None:
        seen[0] += 1
        if seen[0] != at:
            return
        if fault in SIGNALS:
            os.kill(os.getpid(), SIGNALS[fault])
        else:
            # A write or an fsync knows no name.
            raise OSError(ERRORS[fault], os.strerror(ERRORS[fault]), *names)

    for name in TOUCHES:
        setattr(os, name, _after(touched, getattr(os, name)))
    if writes:
        os.fdopen = _counted(touched, os.fdopen)
    _one_process()
    _plain_reports()
    sys.argv = ["stcal", *arguments]
    code = main()
    seen, total = [NEVER], seen[0]
    with open(count, "w") as stream:
        stream.write(str(total))
    return code


def _after(touched: Callable[..., None], function: Callable) -> Callable:
    def wrapped(*args: object, **options: object) -> object:
        touched(*(str(name) for name in args[:1] if not isinstance(name, int)))
        return function(*args, **options)

    return wrapped


def _counted(touched: Callable[..., None], fdopen: Callable) -> Callable:
    class Raw(io.FileIO):
        def write(self, data: object) -> int:
            touched()
            return super().write(data)

    def opened(handle: int, mode: str = "r", *args: object, **options: object) -> object:
        if mode == "wb":
            return io.BufferedWriter(Raw(handle, "wb"))
        return fdopen(handle, mode, *args, **options)

    return opened


def _one_process() -> None:
    """Let the steps of a recalibration run here, so that their touches count too."""
    from stcal.cli import main
    from stcal.operations.run import Runner

    def command(self: Runner, arguments: list[str]) -> tuple[int, str, str]:
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main([*arguments, "--json"])
        if code == 130:
            raise KeyboardInterrupt
        return code, out.getvalue(), err.getvalue()

    Runner.command = command


def _plain_reports() -> None:
    """Leave the drawing out: it takes most of a short fit's time, and touches the disk once."""
    import stcal.report.html
    import stcal.report.upload_html
    from stcal.atomic import write_text

    def write_report(document: object, path: Path) -> None:
        write_text(path, json.dumps(document, sort_keys=True))

    stcal.report.html.write_report = write_report
    stcal.report.html.write_recalibration = lambda fit, validation, path, files=(): write_report(
        [fit, validation], path
    )
