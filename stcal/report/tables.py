"""The report's tables on the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from stcal.report import (
    content,
    difference_content,
    enright_content,
    fit_content,
    study_content,
    tracking_content,
)
from stcal.report.content import Table, Verdict
from stcal.report.document import Document, section
from stcal.report.filter_content import filter_tables, is_sequential
from stcal.report.format import NOT_AVAILABLE, fixed, rms, words

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table as RichTable
    from rich.text import Text

_DASH = "\N{EN DASH}"
# What 80 columns hold of the cycles; the HTML report shows all.
_CYCLE_COLUMNS = ("Cycle", "Matching", "Frames solved", "Matched stars", "Matches changed",
                  "RMS [µrad]", "chi² / dof", "Largest change [sd]")  # fmt: skip
# And of a study's variants.
_DRIFT_COLUMNS = ("Focal length", "Within 3 sd", "Within 1 sd", "Rms error [µm]",
                  "Rms of error / sd", "Late [s]", "RMS / true")  # fmt: skip
_STEP_COLUMNS = ("Variant", "f: frames until within 3 sd", "f within 3 sd",
                 "m0: frames until within 3 sd", "m0 within 3 sd", "RMS / true")  # fmt: skip
_COLOURS = {"accepted": "green", "refused": "red", "unknown": "yellow"}


def fit_tables(document: Document, console: Console) -> None:
    """Print a fit: verdict, before and after, parameters, its way, observability, alignment."""
    _print_verdict(content.verdict(document, "Fit"), document, console)
    for table in (
        fit_content.fit_summary(document),
        fit_content.parameter_table(document),
        *_way_tables(document),
        fit_content.observability_table(document),
        fit_content.c_sd_table(document),
    ):
        _print_table(table, console)


def _way_tables(document: Document) -> tuple[Table, ...]:
    """A filter's tables, or a batch fit's cycles."""
    if is_sequential(document):
        return filter_tables(document)
    return (_only(fit_content.cycle_table(document), _CYCLE_COLUMNS),)


def validation_tables(document: Document, console: Console) -> None:
    """Print a validation: verdict, then baseline against candidate."""
    _print_verdict(content.verdict(document, "Validation"), document, console)
    for build in (content.validation_summary, content.validation_facts):
        _print_table(build(document), console)


def difference_tables(document: Document, console: Console) -> None:
    """Print the difference of two calibrations (``stcal.uplink.compare``)."""
    for table in (
        difference_content.parameter_table(document),
        difference_content.direction_table(document),
    ):
        _print_table(table, console)


def enright_tables(document: Document, console: Console) -> None:
    """Print the study ``enright``: Table V and the findings."""
    for table in (enright_content.error_table(document), study_content.finding_table(document)):
        _print_table(table, console)


def tracking_tables(document: Document, console: Console) -> None:
    """Print the study ``tracking``: drift, step, temperature, and the findings."""
    for table in (
        _only(tracking_content.drift_table(document), _DRIFT_COLUMNS),
        _only(tracking_content.step_table(document), _STEP_COLUMNS),
        tracking_content.temperature_table(document),
        study_content.finding_table(document, "Expectation"),
    ):
        _print_table(table, console)


def summary_table(rows: Sequence[Mapping[str, Any]], console: Console) -> None:
    """Print the rows of :func:`stcal.report.content.summary_row` as Enright 2018 Table IV."""
    from rich.text import Text

    table = _rich_table("")
    table.add_column("Sensor")
    for heading in ("Availability\ninitial", "\nfinal", "Matched\nstar ratio",
                    "RMS [µrad]\ninitial", "\nfinal"):  # fmt: skip
        table.add_column(heading, justify="right")
    table.add_column("Verdict")
    for row in rows:
        availability, errors = section(row, "availability"), section(row, "common_pair_rms_urad")
        word = Verdict("", row.get("accepted"), ()).word
        cells = (
            words(row.get("sensor_id")),
            fixed(availability.get("baseline")),
            fixed(availability.get("candidate")),
            fixed(row.get("matched_star_ratio")),
            rms(errors.get("baseline")),
            rms(errors.get("candidate")),
        )
        table.add_row(*map(_cell, cells), Text(word, style=_COLOURS[word]))
    console.print(table)


def _print_verdict(verdict: Verdict, document: Document, console: Console) -> None:
    from rich.text import Text

    style = f"bold {_COLOURS[verdict.word]}"
    sentence = f"{words(document.get('sensor_id'))}: {verdict.sentence}"
    console.print(Text(sentence, style=style))
    for reason in verdict.reasons:
        console.print(Text(f"  - {reason}"))
    for note in verdict.notes:
        console.print(Text(f"  note: {note}"))


def _print_table(table: Table, console: Console) -> None:
    from rich.text import Text

    result = _rich_table(table.title)
    result.show_header = any(table.header)
    # An interval goes below its value: 80 columns must hold the table.
    rows = [[c.replace(" (", "\n(") for c in row] if table.numeric else row for row in table.rows]
    for index, heading in enumerate(_headings(table)):
        right = table.numeric and index > 0
        result.add_column(heading, justify="right" if right else "left", overflow="fold")
    for row in rows:
        result.add_row(*map(_cell, row))
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


def _only(table: Table, headings: Sequence[str]) -> Table:
    """Return the table with the named columns."""
    places = [table.header.index(heading) for heading in headings]
    rows = tuple(tuple(row[k] for k in places) for row in table.rows)
    return replace(table, header=tuple(headings), rows=rows)


def _rich_table(title: str) -> RichTable:
    from rich import box
    from rich.table import Table as RichTable

    return RichTable(
        title=title or None, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD,
        pad_edge=False, collapse_padding=True,
    )  # fmt: skip


def _cell(value: str) -> Any:
    # Text, not markup: brackets in a sensor's name are not styles.
    from rich.text import Text

    return Text(_DASH, style="dim") if value == NOT_AVAILABLE else Text(value)
