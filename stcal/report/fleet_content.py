"""What the index of a fleet's recalibration says, as tables of text."""

from __future__ import annotations

from collections import Counter

from stcal.report.content import (
    Table,
    Verdict,
    summary_cells,
)
from stcal.report.document import Document, section, sections, text
from stcal.report.format import fixed, words

STATES = ("built", "refused", "failed", "interrupted")


def fleet_verdict(document: Document) -> Verdict:
    """All uploads built, or what was not."""
    found = sections(document.get("sensors"))
    states = Counter(text(item.get("state")) for item in found)
    parts = [f"{states[state]} {state}" for state in STATES if states[state]]
    subject = f"Recalibration of {len(found)} sensors ({', '.join(parts) or 'nothing done'}):"
    reasons = tuple(
        f"{words(item.get('sensor_id'))}: {words(item.get('message'))}"
        for item in found
        if item.get("state") != "built"
    )
    return Verdict(subject, bool(found) and not reasons, reasons, _ingest_notes(document))


def fleet_table(document: Document) -> Table:
    """A row per sensor: state, before and after on held-out frames, and the upload."""
    header = ("Sensor", "State", "Availability initial", "Availability final",
              "Matched star ratio", "RMS initial [µrad]", "RMS final [µrad]", "Upload")  # fmt: skip
    rows = tuple(_row(item) for item in sections(document.get("sensors")))
    return Table("Sensors", header, rows)


def step_table(document: Document) -> Table:
    """A row per sensor: how each step ended."""
    found = sections(document.get("sensors"))
    names = ("fit", "validate", "build")
    rows = []
    for item in found:
        steps = {text(step.get("name")): step for step in sections(item.get("steps"))}
        rows.append((words(item.get("sensor_id")), *(_step(steps.get(name)) for name in names)))
    header = ("Sensor", "Fit", "Validation", "Build")
    note = "Exit code and time; a step found done by an earlier run is marked so."
    return Table("Steps", header, tuple(rows), note)


def _row(item: Document) -> tuple[str, ...]:
    return (
        words(item.get("sensor_id")),
        words(item.get("state")),
        *summary_cells(item),
        words(item.get("upload")),
    )


def _step(step: Document | None) -> str:
    if step is None:
        return "not reached"
    if step.get("again") is True:
        return f"{words(step.get('exit_code'))}, done before"
    return f"{words(step.get('exit_code'))}, {fixed(step.get('seconds'), 1, 's')}"


def _ingest_notes(document: Document) -> tuple[str, ...]:
    ingest = section(document, "ingest")
    code = ingest.get("exit_code")
    if not ingest or code == 0:
        return ()
    message = text(ingest.get("message")) or "more was quarantined than the configured share"
    return (f"ingest ended with exit code {words(code)}: {message}",)
