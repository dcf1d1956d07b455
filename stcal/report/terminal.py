"""Tables and verdicts on a terminal of 80 columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from stcal.report.content import Table, Verdict
from stcal.report.document import Document
from stcal.report.format import NOT_AVAILABLE, words

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table as RichTable
    from rich.text import Text

_DASH = "\N{EN DASH}"
COLOURS = {"accepted": "green", "refused": "red", "unknown": "yellow"}


def print_verdict(verdict: Verdict, document: Document, console: Console) -> None:
    """Print a verdict with its reasons and notes."""
    from rich.text import Text

    style = f"bold {COLOURS[verdict.word]}"
    sentence = f"{words(document.get('sensor_id'))}: {verdict.sentence}"
    console.print(Text(sentence, style=style))
    for reason in verdict.reasons:
        console.print(Text(f"  - {reason}"))
    for note in verdict.notes:
        console.print(Text(f"  note: {note}"))


def print_table(table: Table, console: Console) -> None:
    """Print a table; one without rows is not available."""
    from rich.text import Text

    result = rich_table(table.title)
    result.show_header = any(table.header)
    # An interval goes below its value: 80 columns must hold the table.
    rows = [[c.replace(" (", "\n(") for c in row] if table.numeric else row for row in table.rows]
    for index, heading in enumerate(_headings(table)):
        right = table.numeric and index > 0
        result.add_column(heading, justify="right" if right else "left", overflow="fold")
    for row in rows:
        result.add_row(*map(cell, row))
    if table.rows:
        console.print(result)
    else:
        console.print(Text(f"{table.title}: {NOT_AVAILABLE}", style="bold"))


def _headings(table: Table) -> list[Text]:
    """Return the headings one word a line, so that the numbers set the width; bottoms aligned."""
    from rich.text import Text

    folded = [
        heading.replace(" / ", "\N{NO-BREAK SPACE}/\n").replace(" ", "\n")
        if table.numeric and index
        else heading
        for index, heading in enumerate(table.header)
    ]
    height = max(heading.count("\n") for heading in folded)
    return [Text("\n" * (height - heading.count("\n")) + heading) for heading in folded]


def only_columns(table: Table, headings: Sequence[str]) -> Table:
    """Return the table with the named columns."""
    places = [table.header.index(heading) for heading in headings]
    rows = tuple(tuple(row[k] for k in places) for row in table.rows)
    return replace(table, header=tuple(headings), rows=rows)


def rich_table(title: str) -> RichTable:
    """Return an empty table in the style of all of them."""
    from rich import box
    from rich.table import Table as RichTable

    return RichTable(
        title=title or None, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD,
        pad_edge=False, collapse_padding=True,
    )  # fmt: skip


def cell(value: str) -> Any:
    """Return a value as text of a cell."""
    # Text, not markup: brackets in a sensor's name are not styles.
    from rich.text import Text

    return Text(_DASH, style="dim") if value == NOT_AVAILABLE else Text(value)
