"""The report's tables on the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from stcal.report import (
    content,
    conversion_content,
    difference_content,
    enright_content,
    fit_content,
    fleet_content,
    study_content,
    tracking_content,
)
from stcal.report.content import Table, Verdict
from stcal.report.document import Document
from stcal.report.filter_content import filter_tables, is_sequential
from stcal.report.format import words
from stcal.report.terminal import (
    COLOURS,
    cell,
    only_columns,
    print_table,
    print_verdict,
    rich_table,
)

if TYPE_CHECKING:
    from rich.console import Console

# What 80 columns hold of the cycles; the HTML report shows all.
_CYCLE_COLUMNS = ("Cycle", "Matching", "Frames solved", "Matched stars", "Matches changed",
                  "RMS [µrad]", "chi² / dof", "Largest change [sd]")  # fmt: skip
# And of a study's variants.
_DRIFT_COLUMNS = ("Focal length", "Within 3 sd", "Within 1 sd", "Rms error [µm]",
                  "Rms of error / sd", "Late [s]", "RMS / true")  # fmt: skip
# And of a fleet's sensors.
_FLEET_COLUMNS = ("Sensor", "State", "Availability initial", "Availability final",
                  "Matched star ratio", "RMS initial [µrad]", "RMS final [µrad]")  # fmt: skip
_STEP_COLUMNS = ("Variant", "f: frames until within 3 sd", "f within 3 sd",
                 "m0: frames until within 3 sd", "m0 within 3 sd", "RMS / true")  # fmt: skip


def fit_tables(document: Document, console: Console) -> None:
    """Print a fit: verdict, before and after, parameters, its way, observability, alignment."""
    print_verdict(content.verdict(document, "Fit"), document, console)
    for table in (
        fit_content.fit_summary(document),
        fit_content.parameter_table(document),
        *_way_tables(document),
        fit_content.observability_table(document),
        fit_content.c_sd_table(document),
    ):
        print_table(table, console)


def _way_tables(document: Document) -> tuple[Table, ...]:
    """A filter's tables, or a batch fit's cycles."""
    if is_sequential(document):
        return filter_tables(document)
    return (only_columns(fit_content.cycle_table(document), _CYCLE_COLUMNS),)


def validation_tables(document: Document, console: Console) -> None:
    """Print a validation: verdict, then baseline against candidate."""
    print_verdict(content.verdict(document, "Validation"), document, console)
    for build in (content.validation_summary, content.validation_facts):
        print_table(build(document), console)


def conversion_tables(document: Document, console: Console) -> None:
    """Print a conversion between camera models: verdict, errors, new parameters."""
    print_verdict(content.verdict(document, "Conversion"), document, console)
    print_table(conversion_content.error_table(document), console)
    print_table(conversion_content.parameter_table(document, "new"), console)


def fleet_tables(document: Document, console: Console) -> None:
    """Print a fleet's recalibration: what was not built and why, then a row per sensor."""
    from rich.text import Text

    verdict = fleet_content.fleet_verdict(document)
    console.print(Text(verdict.sentence, style=f"bold {COLOURS[verdict.word]}"))
    for line in (*verdict.reasons, *verdict.notes):
        console.print(Text(f"  - {line}"))
    print_table(only_columns(fleet_content.fleet_table(document), _FLEET_COLUMNS), console)


def difference_tables(document: Document, console: Console) -> None:
    """Print the difference of two calibrations (``stcal.uplink.compare``)."""
    for table in (
        difference_content.parameter_table(document),
        difference_content.direction_table(document),
    ):
        print_table(table, console)


def enright_tables(document: Document, console: Console) -> None:
    """Print the study ``enright``: Table V and the findings."""
    for table in (enright_content.error_table(document), study_content.finding_table(document)):
        print_table(table, console)


def tracking_tables(document: Document, console: Console) -> None:
    """Print the study ``tracking``: drift, step, temperature, and the findings."""
    for table in (
        only_columns(tracking_content.drift_table(document), _DRIFT_COLUMNS),
        only_columns(tracking_content.step_table(document), _STEP_COLUMNS),
        tracking_content.temperature_table(document),
        study_content.finding_table(document, "Expectation"),
    ):
        print_table(table, console)


def summary_table(rows: Sequence[Mapping[str, Any]], console: Console) -> None:
    """Print the rows of :func:`stcal.report.content.summary_row` as Enright 2018 Table IV."""
    from rich.text import Text

    table = rich_table("")
    table.add_column("Sensor")
    for heading in ("Availability\ninitial", "\nfinal", "Matched\nstar ratio",
                    "RMS [µrad]\ninitial", "\nfinal"):  # fmt: skip
        table.add_column(heading, justify="right")
    table.add_column("Verdict")
    for row in rows:
        word = Verdict("", row.get("accepted"), ()).word
        cells = (words(row.get("sensor_id")), *content.summary_cells(row))
        table.add_row(*map(cell, cells), Text(word, style=COLOURS[word]))
    console.print(table)
