"""What was done before: a record beside each step's output, so that a run goes on where one ended.

A step counts as done while its command, the content of all that it reads and the content of all
that it wrote are what they were.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from stcal.atomic import write_text
from stcal.calibration import sha256_of
from stcal.errors import InputError
from stcal.operations.steps import Step
from stcal.reading import read_json_object
from stcal.version import __version__

SCHEMA = "stcal.step/1"
SUCCESS = (0, 5)
# A refusal comes of the content, and would come again.
LASTING = (*SUCCESS, 4)


@dataclass(frozen=True)
class Outcome:
    """How a step ended.

    Attributes
    ----------
    name : of the step
    exit_code : of its command
    message : its error or refusal in one text, empty when it succeeded
    seconds : that it took
    again : whether this is the outcome of an earlier run, found to hold still
    """

    name: str
    exit_code: int
    message: str
    seconds: float
    again: bool = False

    @property
    def succeeded(self) -> bool:
        """Whether the next step may follow."""
        return self.exit_code in SUCCESS


def key_of(step: Step) -> str:
    """Return a hash of the command and of all that it reads."""
    read = [[str(path), _sha256(path)] for path in step.inputs]
    return _hash(json.dumps([__version__, step.arguments, read]))


def recall(step: Step, key: str) -> Outcome | None:
    """Return the outcome of an earlier run of the same step, None when it doesn't hold."""
    try:
        found = read_json_object(_path(step))
        outcome = Outcome(**found["outcome"])
        outputs = found["outputs"]
        same = found["schema"] == SCHEMA and found["key"] == key
    except (InputError, KeyError, TypeError):
        return None
    if not same or outputs != _contents(step) or outcome.exit_code not in LASTING:
        return None
    return Outcome(**(asdict(outcome) | {"again": True}))


def remember(step: Step, key: str, outcome: Outcome) -> None:
    """Write the record of a step that has ended; without it the step is done again."""
    document = {
        "schema": SCHEMA,
        "key": key,
        "arguments": list(step.arguments),
        "outcome": asdict(outcome),
        "outputs": _contents(step),
    }
    write_text(_path(step), json.dumps(document, indent=1) + "\n")


def forget(step: Step) -> None:
    """Remove the record before a step begins, so that a killed one is not taken for done."""
    _path(step).unlink(missing_ok=True)


def _path(step: Step) -> Path:
    return step.folder / f"{step.name}.step.json"


def _contents(step: Step) -> dict[str, str]:
    """Return the hashes of a step's outputs, by their paths within its folder."""
    return {
        str(path.relative_to(step.folder)): _sha256(path)
        for path in sorted(_expanded(step.outputs))
    }


def _expanded(outputs: Iterable[Path]) -> Iterator[Path]:
    for output in outputs:
        if output.is_dir():
            yield from (path for path in output.rglob("*") if path.is_file())
        else:
            yield output


def _sha256(path: Path) -> str:
    try:
        return sha256_of(path)
    except OSError as error:
        return f"cannot be read: {error.strerror}"


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()
