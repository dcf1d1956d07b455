"""Run a plan: sensors by an ordered map, each step a process of its own.

A process can be stopped at any moment, whichever thread, process or machine waits for it; its
crash and its memory are no other sensor's; and what it prints is its own.
"""

from __future__ import annotations

import errno
import json
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

from stcal.atomic import TEMPORARY_PREFIX, clear, write_text
from stcal.errors import InputError
from stcal.execution import OrderedMap
from stcal.operations import record
from stcal.operations.lifeline import lifeline
from stcal.operations.plan import PlanFile, Sensor
from stcal.operations.record import Outcome
from stcal.operations.steps import Step, ingest_step, report_arguments, sensor_steps

INTERRUPTED = 130
# The worse one of two exit codes stands later.
_BY_SEVERITY = (0, 5, 4, 3, 2, 1, INTERRUPTED)


@dataclass(frozen=True)
class SensorRun:
    """How far one sensor came: its steps in their order, the last perhaps not successful."""

    sensor: Sensor
    outcomes: tuple[Outcome, ...]

    @property
    def exit_code(self) -> int:
        """The worst exit code of its steps."""
        return worst(outcome.exit_code for outcome in self.outcomes)

    @property
    def state(self) -> str:
        """``built``, ``refused``, ``failed`` or ``interrupted``."""
        if not self.outcomes or self.exit_code == INTERRUPTED:
            return "interrupted"
        if self.outcomes[-1].succeeded:
            return "built"
        return "refused" if self.exit_code == 4 else "failed"


@dataclass(frozen=True)
class FleetRun:
    """A run of a whole plan."""

    ingest: Outcome | None
    sensors: tuple[SensorRun, ...]

    @property
    def exit_code(self) -> int:
        """The worst exit code of all steps."""
        first = () if self.ingest is None else (self.ingest.exit_code,)
        return worst((*first, *(run.exit_code for run in self.sensors)))


def worst(codes: Any) -> int:
    """Return the worst of exit codes; one that stcal doesn't have counts as an internal error."""
    known = [code if code in _BY_SEVERITY else 1 for code in codes]
    return max(known, key=_BY_SEVERITY.index, default=0)


@dataclass(frozen=True)
class Runner:
    """Runs steps as processes, on whichever worker, and stops them with the run.

    Attributes
    ----------
    mark : file that stands while the run goes on, the one sign that threads, processes and
        machines all see: when it is gone, steps are ended and none begins
    """

    mark: Path | None = None

    @property
    def stopped(self) -> bool:
        """Whether the run has ended."""
        if self.mark is None:
            return False
        try:
            # A network file system may answer from memory whether a file exists, but opens it.
            self.mark.open("rb").close()
        except OSError as error:
            return error.errno in (errno.ENOENT, errno.ESTALE)
        return False

    def step(self, step: Step) -> Outcome:
        """Run a step, or recall that it was done; its log and record go to its folder."""
        if self.stopped:
            return Outcome(step.name, INTERRUPTED, "interrupted", 0.0)
        key = record.key_of(step)
        done = record.recall(step, key)
        if done is not None:
            return done
        step.folder.mkdir(parents=True, exist_ok=True)
        record.forget(step)
        outcome = self._run(step)
        if outcome.exit_code != INTERRUPTED:
            record.remember(step, key, outcome)
        return outcome

    def _run(self, step: Step) -> Outcome:
        start = time.monotonic()
        code, printed, told = self.command(step.arguments)
        seconds = round(time.monotonic() - start, 2)
        log = [f"stcal {' '.join(step.arguments)}", f"exit code {code}", told, printed]
        write_text(step.folder / f"{step.name}.log", "\n".join(filter(None, log)) + "\n")
        return Outcome(
            step.name, code, "" if code in record.SUCCESS else _message(printed, told), seconds
        )

    def command(self, arguments: Sequence[str]) -> tuple[int, str, str]:
        """Run ``stcal`` with ``--json``; return exit code, standard output and error."""
        command = [sys.executable, "-m", "stcal", *arguments, "--json"]
        with lifeline() as options, subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            text=True, errors="backslashreplace", **options,
        ) as process:  # fmt: skip
            while True:
                try:
                    printed, told = process.communicate(timeout=0.2)
                    break
                except subprocess.TimeoutExpired:
                    if self.stopped:
                        # Told once: a second signal would disturb its clearing up.
                        process.terminate()
                        printed, told = process.communicate()
                        break
                except KeyboardInterrupt:
                    process.terminate()
                    process.wait()
                    raise
        # Signalled before it could tell; the machine's kill, for want of memory, is another.
        early = process.returncode in (-signal.SIGINT, -signal.SIGTERM)
        return (INTERRUPTED if early else process.returncode), printed, told


def recalibrate(file: PlanFile, mapper: OrderedMap, runner: Runner | None = None) -> FleetRun:
    """Run the plan: ingest, then each sensor's fit, validation and build.

    A sensor's step that fails or is refused ends that sensor's work and nobody else's.  What an
    earlier run of the same plan did on the same content isn't done again.  The folder of the
    results is to be held by :func:`stcal.atomic.locked`, which removes a killed run's mark.

    Raises
    ------
    KeyboardInterrupt
        The running steps are stopped as soon as their workers see it, at the latest when the map
        is closed; those of a cluster a moment later.  What was done stays done.
    """
    file.out.mkdir(parents=True, exist_ok=True)
    with NamedTemporaryFile(prefix=f"{TEMPORARY_PREFIX}running-", dir=file.out) as mark:
        runner = replace(runner or Runner(), mark=Path(mark.name))
        first = ingest_step(file)
        outcome = None if first is None else runner.step(first)
        runs = tuple(mapper(partial(_one_sensor, file, runner), file.plan.sensors))
    return FleetRun(outcome, runs)


def _one_sensor(file: PlanFile, runner: Runner, sensor: Sensor) -> SensorRun:
    outcomes: list[Outcome] = []
    folder = file.out / sensor.sensor_id
    try:
        clear(folder)  # the records and the report are written by the run, which holds ``out``
        for step in sensor_steps(file, sensor):
            outcomes.append(runner.step(step))
            if not outcomes[-1].succeeded:
                break
    except InputError as error:
        outcomes.append(Outcome("store", error.exit_code, str(error), 0.0))
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        outcomes.append(
            Outcome("files", InputError.exit_code, f"{where}{error.strerror or error}", 0.0)
        )
    _report(folder, outcomes, runner)
    return SensorRun(sensor, tuple(outcomes))


def _report(folder: Path, outcomes: Sequence[Outcome], runner: Runner) -> None:
    """Make the report of fit and validation where both were done, unless it is there."""
    done = {outcome.name: outcome for outcome in outcomes if outcome.exit_code in record.LASTING}
    if "fit" not in done or "validate" not in done:
        return
    old = done["fit"].again and done["validate"].again and (folder / "report.html").exists()
    if not old and not runner.stopped:
        runner.command(report_arguments(folder))


def _message(printed: str, told: str) -> str:
    """Return what a command said was wrong."""
    try:
        said = json.loads(printed).get("error")
    except (ValueError, AttributeError):
        said = None
    lines = [line.removeprefix("stcal: ") for line in told.splitlines() if line.strip()]
    return str(said) if said else (lines[-1] if lines else "ended without a message")
