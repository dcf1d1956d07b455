"""What every command prints with: one JSON document or rich tables, and progress."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import click

if TYPE_CHECKING:
    from rich.console import Console

    from stcal.execution import OrderedMap

T = TypeVar("T")
U = TypeVar("U")


class Progress(Protocol):
    """What long work reports its steps to."""

    def advance(self, n: float = 1.0) -> None:
        """Count n more steps as done."""

    def describe(self, text: str) -> None:
        """Change the text in front of the bar."""

    def restart(self, total: float) -> None:
        """Begin a new count of steps."""


class _Silent:
    def advance(self, n: float = 1.0) -> None:
        return

    def restart(self, total: float) -> None:
        return

    def describe(self, text: str) -> None:
        return


SILENT: Progress = _Silent()


def emit(document: dict[str, Any], as_json: bool, human: Callable[[Console], None]) -> None:
    """Print the document as JSON, or let ``human`` print tables to the console."""
    if as_json:
        click.echo(json.dumps(document, indent=1, allow_nan=False))
        return
    human(_console())


def plain(text: str) -> str:
    """Return text with everything that would steer a terminal as an escape such as ``\\x1b``."""
    return "".join(c if c.isprintable() or c in "\n\t" else _escape(c) for c in text)


def _escape(character: str) -> str:
    return character.encode("unicode_escape", "surrogatepass").decode("ascii")


def _console() -> Console:
    """Return a console on which names from files are text: no markup, no escape sequences."""
    from rich.console import Console, ConsoleOptions, RenderableType
    from rich.segment import Segment

    class Plain(Console):
        def render(
            self, renderable: RenderableType, options: ConsoleOptions | None = None
        ) -> Iterator[Segment]:
            for one in super().render(renderable, options):
                yield one if one.control else Segment(plain(one.text), one.style)

    return Plain(markup=False, emoji=False)


def conclude(document: dict[str, Any], as_json: bool, human: Callable[[Console], None]) -> None:
    """Print a judged document; a refused one ends the command.

    Raises
    ------
    GateRefusalError
        When the document's verdict is a refusal; as JSON the error carries the document.
    """
    from stcal.pipeline.fit import refusal_of

    accepted = document["verdict"]["accepted"]
    if accepted or not as_json:
        emit(document, as_json, human)
    if not accepted:
        raise refusal_of(document)


def write_documents(document: dict[str, Any], path: Path, report: Path) -> None:
    """Write a document and the HTML report made of it."""
    from stcal.atomic import write_text
    from stcal.calibration import canonical_json
    from stcal.report.html import write_report

    write_text(path, canonical_json(document))
    write_report(document, report)


def watched(mapper: OrderedMap, bar: Progress) -> OrderedMap:
    """Return the map with each of its passes shown by the bar."""

    def mapped(function: Callable[[T], U], items: Iterable[T]) -> Iterator[U]:
        listed = list(items)
        bar.restart(len(listed))
        for result in mapper(function, listed):
            bar.advance()
            yield result

    return mapped


@contextmanager
def progress(description: str, total: float | None = None) -> Iterator[Progress]:
    """Show a progress bar on standard error, on a terminal only."""
    if not sys.stderr.isatty():
        yield SILENT
        return
    from rich.console import Console
    from rich.progress import Progress as RichProgress

    with RichProgress(console=Console(stderr=True), transient=True) as bar:
        yield _Bar(bar, bar.add_task(description, total=total))


class _Bar:
    def __init__(self, bar: Any, task: Any) -> None:
        self._bar, self._task = bar, task

    def advance(self, n: float = 1.0) -> None:
        self._bar.advance(self._task, n)

    def describe(self, text: str) -> None:
        self._bar.update(self._task, description=text)

    def restart(self, total: float) -> None:
        self._bar.reset(self._task, total=total)
