"""What the report of a conversion between camera models says, as tables of text."""

from __future__ import annotations

from stcal.report.content import Table
from stcal.report.document import Document, number, section, sections, text
from stcal.report.format import fixed, measured, significant, spread, vector, words
from stcal.units import unit_of


def error_table(document: Document) -> Table:
    """How far the new camera's directions depart from the old one's."""
    found = section(document, "errors")
    where = f"row {fixed(found.get('at_row_px'), 1)}, column {fixed(found.get('at_col_px'), 1)}"
    limit = found.get("maximum_urad")
    rows = [
        ("Worst error of a direction", significant(found.get("worst_urad"), 3, "µrad")),
        ("at", where),
        ("Worst error of a centroid", significant(found.get("worst_px"), 3, "px")),
        ("RMS error of the directions", significant(found.get("rms_urad"), 3, "µrad")),
        ("RMS error of the centroids", significant(found.get("rms_px"), 3, "px")),
        ("Turn of D, taken up by C_SD, x y z", vector(document.get("turn_arcsec"), 3, "arcsec")),
    ]
    if limit is not None:
        rows.insert(2, ("Largest error allowed", significant(limit, 3, "µrad")))
    return Table("Errors over the detector", ("", ""), tuple(rows), numeric=False)


def parameter_table(document: Document, which: str) -> Table:
    """The parameters of the ``old`` or the ``new`` calibration in readable units."""
    found = section(document, which)
    rows = tuple(_row(item) for item in sections(found.get("parameters")))
    model, serial = (words(found.get(key)) for key in ("model", "serial"))
    return Table(
        f"{which.capitalize()} camera: {model}, serial {serial}", ("Parameter", "Value", "sd"), rows
    )


def source_table(document: Document) -> Table:
    """What was converted, and by what."""
    old = section(document, "old")
    rows = (
        ("Sensor", words(document.get("sensor_id"))),
        ("Converted file", words(old.get("file"))),
        ("its SHA-256", words(old.get("sha256"))),
        ("Software", words(document.get("software"))),
    )
    return Table("The conversion", ("", ""), rows, numeric=False)


def _row(item: Document) -> tuple[str, ...]:
    unit = unit_of(text(item.get("name")))
    value, sd = (number(item.get(key)) for key in ("value", "sd"))
    value, sd = (None if v is None else v / unit.size for v in (value, sd))
    return unit.label, measured(value, sd), spread(sd)
