"""What the difference of two calibrations says, as tables of text."""

from __future__ import annotations

from stcal.report.content import Table
from stcal.report.document import Document, number, section, sections, text
from stcal.report.format import fixed, measured, spread, vector, words
from stcal.units import unit_of


def parameter_table(document: Document) -> Table:
    """Change of each parameter in readable units and in sd."""
    old, new = (_named(section(document, which)) for which in ("old", "new"))
    header = ("Parameter", "Old", "New", "Change", "sd", "Change [sd]",
              "Change [both sd]")  # fmt: skip
    rows = tuple(_row(item) for item in sections(document.get("parameters")))
    return Table(f"{old} to {new}", header, rows)


def direction_table(document: Document) -> Table:
    """Alignment and directions."""
    found = section(document, "directions")
    where = f"row {fixed(found.get('at_row_px'), 0)}, column {fixed(found.get('at_col_px'), 0)}"
    turned = vector(document.get("c_sd_rotation_arcsec"), 2, "arcsec")
    rows = (
        ("C_SD rotation, x y z of S", turned),
        ("Attitude jump, x y z of S", vector(found.get("net_rotation_arcsec"), 2, "arcsec")),
        ("Worst direction change, rotation removed", fixed(found.get("worst_urad"), 1, "µrad")),
        ("at", where),
        ("RMS direction change, rotation removed", fixed(found.get("rms_urad"), 1, "µrad")),
    )
    return Table("Alignment and directions", ("", ""), rows, numeric=False)


def _named(which: Document) -> str:
    return f"{words(which.get('sensor_id'))} serial {words(which.get('serial'))}"


def _row(item: Document) -> tuple[str, ...]:
    unit = unit_of(text(item.get("name")))
    values = (number(item.get(key)) for key in ("old", "new", "change", "sd"))
    old, new, change, sd = (None if v is None else v / unit.size for v in values)
    return (
        unit.label,
        measured(old, sd),
        measured(new, sd),
        measured(change, sd, signed=True),
        spread(sd),
        fixed(item.get("change_sd"), 1, signed=True),
        fixed(item.get("change_combined_sd"), 1, signed=True),
    )
