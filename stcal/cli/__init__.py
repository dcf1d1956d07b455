"""The command ``stcal``: one module a command, imported only when that command is called."""

from __future__ import annotations

import gc
import importlib
import io
import json
import os
import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

import click

from stcal.errors import InputError, StcalError
from stcal.version import __version__

# Name and one line of help, so that `stcal --help` imports no command.
COMMANDS = {
    "ingest": "Read downlinked telemetry into a Parquet store.",
    "quarantine": "List, show and try again what ingest refused.",
    "packets": "Explain packet layouts and write them as XTCE.",
    "match": "Identify the stars of stored telemetry with a calibration.",
    "fit": "Refit the camera from stored telemetry.",
    "align": "Estimate how a sensor sits in the spacecraft's body.",
    "validate": "Compare two calibrations on held-out telemetry.",
    "uplink": "Build and compare calibration upload files.",
    "report": "Make the HTML report of a fit or validation again.",
    "recalibrate": "Run a shift's work: ingest, fit, validate and build for a fleet.",
    "summary": "Print one table of several validations.",
    "simulate": "Make telemetry of a simulated sensor.",
    "camera": "Convert calibrations between camera models.",
    "study": "Run a study on simulated sensors and write its report.",
    "catalog": "Build or describe a star catalogue.",
    "sensor": "Check sensor configurations.",
}
EXIT_INTERNAL, EXIT_INTERRUPTED = 1, 130


class _LazyGroup(click.Group):
    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"stcal.cli.{cmd_name}")
        command: click.Command = module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.command(cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="stcal")
def cli() -> None:
    """Recalibrate star trackers in orbit from downlinked telemetry.

    Exit codes: 0 done; 1 internal error; 2 usage; 3 bad input or configuration; 4 refused by a
    safety gate; 5 done, but more input was quarantined than the configured share; 130 interrupted.
    """


def main(arguments: list[str] | None = None) -> int:
    """Run the command line and return the exit code (the console script exits with it)."""
    own_process = arguments is None
    arguments = sys.argv[1:] if arguments is None else arguments
    # A command is short, and most of its objects (modules, figures) live to its end: collecting
    # as often as by default costs a twentieth of its time.
    gc.set_threshold(200_000, 50, 50)
    as_json = "--json" in arguments
    try:
        if own_process:
            _prepare_process()
        code = cli.main(args=arguments, prog_name="stcal", standalone_mode=False)
        return code if isinstance(code, int) else 0
    except click.exceptions.Abort:
        return _fail("interrupted", EXIT_INTERRUPTED, as_json)
    except KeyboardInterrupt:
        return _fail("interrupted", EXIT_INTERRUPTED, as_json)
    except click.ClickException as error:
        if not as_json:
            error.show()
            return error.exit_code
        return _fail(error.format_message(), error.exit_code, as_json)
    except StcalError as error:
        return _fail(str(error), error.exit_code, as_json, error.document)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_INTERNAL
    except Exception as error:
        if isinstance(error, OSError) and error.errno is not None:
            # A full disk, a missing permission: a place that the user named is of no use.
            where = f"{error.filename}: " if error.filename else ""
            return _fail(f"{where}{os.strerror(error.errno)}", InputError.exit_code, as_json)
        return _internal(error, as_json)


def run() -> NoReturn:
    """Be the process of a command, and end with its exit code.

    The interpreter is not taken apart: a thread of Arrow's that then still lets go of what it read
    would abort the process ("terminate called without an active exception").
    """
    code = main()
    for stream in filter(None, (sys.stdout, sys.stderr)):
        with suppress(OSError, ValueError):  # nobody reads it any more
            stream.flush()
    os._exit(code)


def _prepare_process() -> None:
    """Let SIGTERM end a command as SIGINT does, and no terminal's encoding make it fail."""
    from stcal.operations.lifeline import follow

    if signal.getsignal(signal.SIGTERM) == signal.SIG_DFL:
        # What is half-written goes, and the exit code is 130.
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    follow()


def _fail(message: str, code: int, as_json: bool, document: dict[str, Any] | None = None) -> int:
    from stcal.cli.output import plain

    with suppress(OSError):  # what failed may be the very place to tell it
        click.echo(plain(f"stcal: {message}"), err=True)
        if as_json:
            body = dict(document or {})
            body.setdefault("error", message)
            body["exit_code"] = code
            click.echo(json.dumps(body, indent=1))
    return code


def _internal(error: Exception, as_json: bool) -> int:
    import tempfile
    import traceback

    handle, name = tempfile.mkstemp(prefix="stcal-crash-", suffix=".txt", text=True)
    with os.fdopen(handle, "w") as stream:
        traceback.print_exception(error, file=stream)
    message = f"internal error: {type(error).__name__}: {error} (details in {Path(name)})"
    return _fail(message, EXIT_INTERNAL, as_json)
