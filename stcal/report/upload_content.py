"""What the report of an upload says, as tables of text."""

from __future__ import annotations

import json

from stcal.report.content import Table, Verdict
from stcal.report.document import (
    Document,
    section,
    sections,
    sequence,
    text,
)
from stcal.report.format import count, significant, words

_FIGURES_LENGTH = 300


def upload_verdict(document: Document) -> Verdict:
    """Built; with the overrides as notes, and whether each was needed."""
    overrides, gates = section(document, "overrides"), section(document, "gates")
    notes = tuple(
        f"gate {gate} {_overridden(section(gates, gate))}: {words(overrides[gate])}"
        for gate in overrides
    )
    return Verdict("Upload", True, (), notes)


def gate_table(document: Document) -> Table:
    """A row per gate: whether it passed, and why not."""
    gates = section(document, "gates")
    rows = tuple((text(name), _state(section(gates, name)), _why(section(gates, name)))
                 for name in gates)  # fmt: skip
    return Table("Gates", ("Gate", "State", "Reasons"), rows, numeric=False)


def figure_table(document: Document) -> Table:
    """The figures that the gates looked at."""
    gates = section(document, "gates")
    rows = []
    for name in gates:
        figures = {k: v for k, v in section(gates, name, "figures").items() if k != "fields"}
        told = json.dumps(figures, sort_keys=True, default=str)
        if len(told) > _FIGURES_LENGTH:
            told = told[:_FIGURES_LENGTH] + " … (all in manifest.json)"
        rows.append((text(name), told if figures else "none"))
    return Table("Figures of the gates", ("", ""), tuple(rows), numeric=False)


def field_table(document: Document) -> Table:
    """What the target holds, field by field."""
    fields = section(document, "gates", "table", "figures").get("fields")
    rows = tuple(
        (words(f.get("name")), words(f.get("holds")), significant(f.get("on_target"), 9),
         words(f.get("unit")), words(f.get("word")), significant(f.get("error"), 2))
        for f in sections(fields)
    )  # fmt: skip
    header = ("Field", "Holds", "On the target", "Unit", "Word", "Rounding")
    return Table("Table on the target", header, rows, "Rounding in SI or pixels.")


def file_table(document: Document) -> Table:
    """Every file with its size and hash."""
    files, crcs = section(document, "files"), section(document, "crc16_arc")
    rows = tuple(
        (text(name), count(section(files, name).get("bytes")),
         words(section(files, name).get("sha256")), words(crcs.get(name)))
        for name in files
    )  # fmt: skip
    return Table("Files", ("File", "Bytes", "SHA-256", "CRC-16/ARC"), rows, numeric=False)


def upload_facts(document: Document) -> Table:
    """What is uploaded over what, and of which data."""
    parent, data = section(document, "parent"), section(document, "data")
    fit, validation = section(data, "fit"), section(data, "validation")
    rows = (
        ("Sensor", words(document.get("sensor_id"))),
        ("Serial", words(document.get("serial"))),
        ("Over serial", words(parent.get("serial"))),
        ("Parent SHA-256", words(parent.get("sha256"))),
        ("Fitted to", f"{words(fit.get('from'))} to {words(fit.get('to'))}"),
        ("Judged on", f"{words(validation.get('from'))} to {words(validation.get('to'))}"),
        ("Target", words(section(document, "target").get("name"))),
        ("Software", words(document.get("software"))),
    )
    return Table("The upload", ("", ""), rows, numeric=False)


def _overridden(gate: Document) -> str:
    return "passed, its override was not needed" if gate.get("passed") is True else "overridden"


def _state(gate: Document) -> str:
    if gate.get("passed") is True:
        return "passed"
    return "overridden" if gate.get("override") else "refused"


def _why(gate: Document) -> str:
    reasons = "; ".join(map(text, sequence(gate.get("reasons"))))
    override = gate.get("override")
    return f"{reasons} (overridden: {words(override)})" if override else reasons
