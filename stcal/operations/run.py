"""Run a plan: each step a process of its own, so that one failing sensor leaves the others."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event
from typing import Any

from stcal.atomic import clear, write_text
from stcal.errors import InputError
from stcal.execution import OrderedMap
from stcal.operations import record
from stcal.operations.lifeline import lifeline
from stcal.operations.plan import PlanFile, Sensor
from stcal.operations.record import Outcome
from stcal.operations.steps import Step, ingest_step, report_arguments, sensor_steps

STEPS_PER_SENSOR = 3
INTERRUPTED = 130
# The worse one of two exit codes stands later.
_BY_SEVERITY = (0, 5, 4, 3, 2, 1, INTERRUPTED)

# Told after each step: the sensor ("" for the ingest) and how the step ended.
OnStep = Callable[[str, Outcome], None]


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


@dataclass
class Runner:
    """Runs steps as processes and can stop them."""

    stopped: Event = field(default_factory=Event)

    def step(self, step: Step) -> Outcome:
        """Run a step, or recall that it was done; its log and record go to its folder."""
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
        if self.stopped.is_set():
            return Outcome(step.name, INTERRUPTED, "interrupted", 0.0)
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
                    if self.stopped.is_set():
                        process.terminate()
                except KeyboardInterrupt:
                    process.terminate()
                    raise
        # A step that a signal ended was interrupted with the run, or killed by the machine.
        code = process.returncode
        return (INTERRUPTED if code < 0 and self.stopped.is_set() else code), printed, told


def recalibrate(
    file: PlanFile,
    mapper: OrderedMap,
    runner: Runner,
    on_step: OnStep = lambda sensor, outcome: None,
) -> FleetRun:
    """Run the plan: ingest, then each sensor's fit, validation and build.

    A sensor's step that fails or is refused ends that sensor's work and nobody else's.  What an
    earlier run of the same plan did on the same content isn't done again.

    Raises
    ------
    KeyboardInterrupt
        After all running steps have been stopped; what was done stays done.
    """
    first = ingest_step(file)
    outcome = None
    if first is not None:
        outcome = runner.step(first)
        on_step("", outcome)

    def one(sensor: Sensor) -> SensorRun:
        return _one_sensor(file, sensor, runner, on_step)

    try:
        runs = tuple(mapper(one, file.plan.sensors))
    except KeyboardInterrupt:
        runner.stopped.set()
        raise
    return FleetRun(outcome, runs)


def _one_sensor(file: PlanFile, sensor: Sensor, runner: Runner, on_step: OnStep) -> SensorRun:
    outcomes: list[Outcome] = []
    folder = file.out / sensor.sensor_id
    try:
        clear(folder)  # the records and the report are written by the run, which holds ``out``
        for step in sensor_steps(file, sensor):
            outcomes.append(runner.step(step))
            on_step(sensor.sensor_id, outcomes[-1])
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
    if not old and not runner.stopped.is_set():
        runner.command(report_arguments(folder))


def _message(printed: str, told: str) -> str:
    """Return what a command said was wrong."""
    try:
        said = json.loads(printed).get("error")
    except (ValueError, AttributeError):
        said = None
    lines = [line.removeprefix("stcal: ") for line in told.splitlines() if line.strip()]
    return str(said) if said else (lines[-1] if lines else "ended without a message")
