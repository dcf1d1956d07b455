"""What a report says, as tables of text: the terminal and the HTML file show the same ones.

Here what both reports share, and the validation; the fit is in ``fit_content``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stcal.report.document import (
    Document,
    Floats,
    columns,
    matrix,
    number,
    section,
    sequence,
    text,
)
from stcal.report.format import (
    NOT_AVAILABLE,
    count,
    fixed,
    interval,
    percent,
    rms,
    share,
    vector,
    words,
)


@dataclass(frozen=True)
class Table:
    """A titled table of text; the first column names the row."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    numeric: bool = True


@dataclass(frozen=True)
class Verdict:
    """Whether a result may be used, why (not), and what else should be known."""

    subject: str
    accepted: bool | None
    reasons: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def word(self) -> str:
        """The verdict in one word."""
        return {None: "unknown", True: "accepted", False: "refused"}[self.accepted]

    @property
    def sentence(self) -> str:
        """The verdict with its subject."""
        if self.accepted is None:
            return f"{self.subject}: verdict {NOT_AVAILABLE}"
        return f"{self.subject} {self.word}"


def verdict(document: Document, subject: str) -> Verdict:
    """Return the document's verdict; a missing one is neither accepted nor refused."""
    found = section(document, "verdict")
    accepted = found.get("accepted")
    reasons, notes = (
        tuple(filter(None, map(text, sequence(found.get(key))))) for key in ("reasons", "notes")
    )
    return Verdict(subject, accepted if isinstance(accepted, bool) else None, reasons, notes)


def validation_summary(document: Document) -> Table:
    """Baseline against candidate on held-out data, each with its confidence interval."""
    rows = [_validation_row(document, *line) for line in _COMPARED]
    level = share(document.get("confidence"))
    header = ("On held-out data", "Baseline", "Candidate", "Candidate / baseline")
    note = f"In parentheses: {level} confidence interval, bootstrap over frames."
    return Table("Before and after", header, tuple(rows), note)


def validation_facts(document: Document) -> Table:
    """What was compared, on what."""
    span = section(document, "span")
    rows: list[tuple[str, ...]] = [
        ("Sensor", words(document.get("sensor_id"))),
        ("Time span", f"{words(span.get('from'))} to {words(span.get('to'))}"),
        ("Matching", words(document.get("matching"))),
        ("Frames", count(document.get("frames"))),
        ("Frames that count for availability", count(document.get("counted_frames"))),
        ("Common pairs", count(document.get("pairs"))),
        ("Common pairs from matches of", words(document.get("pairs_from"))),
        ("Attitude offset, x y z", vector(document.get("attitude_offset_arcsec"), 2, "arcsec")),
        ("Attitude spread, x y z", spread_of(document.get("attitude_spread_arcsec"), 2)),
        (
            "Attitude sd of the mean, x y z",
            spread_of(document.get("attitude_sd_of_mean_arcsec"), 3),
        ),
    ]
    for which in ("baseline", "candidate"):
        item = section(document, which)
        rows.append((f"{which.capitalize()} serial", words(item.get("serial"))))
        rows.append((f"{which.capitalize()} SHA-256", words(item.get("sha256"))))
    rows.extend(origin(document))
    return Table("The validation", ("", ""), tuple(rows), numeric=False)


def provenance_table(document: Document) -> Table:
    """Hashes and versions that the result came from."""
    found = section(document, "provenance")
    rows = tuple((text(key).replace("_", " "), words(value)) for key, value in found.items())
    return Table("Provenance", ("", ""), rows, numeric=False)


def summary_row(document: Document) -> dict[str, Any]:
    """Return one sensor's line of Enright 2018 Table IV from its validation document."""
    availability, errors = (
        section(document, "availability"),
        section(document, "common_pair_rms_urad"),
    )
    accepted = section(document, "verdict").get("accepted")
    return {
        "sensor_id": text(document.get("sensor_id")) or None,
        "availability": {key: number(availability.get(key)) for key in ("baseline", "candidate")},
        "matched_star_ratio": number(document.get("matched_star_ratio")),
        "common_pair_rms_urad": {key: number(errors.get(key)) for key in ("baseline", "candidate")},
        "accepted": accepted if isinstance(accepted, bool) else None,
    }


def field_rms(document: Document, which: str) -> float | None:
    """Return the RMS [px] of the cells' mean residual vectors, weighted by their stars."""
    keys = (f"{which}_row_px", f"{which}_col_px", "count")
    found = columns(section(document, "field"), *keys)
    return None if found is None else weighted_rms(np.hypot(found[0], found[1]), found[2])


def weighted_rms(sizes: Floats, weights: Floats) -> float | None:
    """Return the RMS of sizes (N,) by weights (N,); None without a weighted size."""
    good = np.isfinite(sizes) & (weights > 0)
    if not good.any():
        return None
    return float(np.sqrt(np.average(sizes[good] ** 2, weights=weights[good])))


# label, key, ratio's key, formatting of a value, decimals, factor of an interval's bounds
_COMPARED = (
    ("Availability", "availability", "", percent, 1, 100.0),
    ("Matched stars", "matched_stars", "matched_star_ratio", count, 0, 1.0),
    ("Common-pair RMS [µrad]", "common_pair_rms_urad", "rms_ratio", rms, 1, 1.0),
)


def _validation_row(
    document: Document, label: str, key: str, ratio: str, show: Any, decimals: int, factor: float
) -> tuple[str, ...]:
    values, bounds = section(document, key), section(document, key, "interval")
    cells = [
        _bracketed(show(values.get(which)), interval(bounds.get(which), decimals, factor))
        for which in ("baseline", "candidate")
    ]
    if ratio:
        compared = fixed(document.get(ratio), 3)
        cells.append(_bracketed(compared, interval(document.get(f"{ratio}_interval"), 3)))
    else:
        cells.append(ratio_of(number(values.get("baseline")), number(values.get("candidate"))))
    return (label, *cells)


def origin(document: Document) -> tuple[tuple[str, str], ...]:
    """Rows that say what made the document, and when."""
    return (
        ("Software", words(document.get("software"))),
        ("Created", words(document.get("created_utc"))),
    )


def _bracketed(value: str, bounds: str) -> str:
    return value if NOT_AVAILABLE in (value, bounds) else f"{value} ({bounds})"


def matrix_rows(name: str, value: Any) -> list[tuple[str, str]]:
    """Return a 3 x 3 matrix row by row; one row that says so where there is none."""
    lines = matrix(value, 3)
    if lines is None:
        return [(name, NOT_AVAILABLE)]
    pairs = zip("xyz", lines, strict=False)
    return [(f"{name} row {axis}", vector(line.tolist(), 9)) for axis, line in pairs]


def summary_cells(row: Document) -> tuple[str, ...]:
    """Return availability, matched star ratio and RMS, before and after: Enright's Table IV."""
    availability, errors = section(row, "availability"), section(row, "common_pair_rms_urad")
    return (
        fixed(availability.get("baseline")),
        fixed(availability.get("candidate")),
        fixed(row.get("matched_star_ratio")),
        rms(errors.get("baseline")),
        rms(errors.get("candidate")),
    )


def quotient(above: Any, below: Any) -> float | None:
    """Return above / below, or None where either is missing or below is zero."""
    numerator, denominator = number(above), number(below)
    return numerator / denominator if numerator is not None and denominator else None


def ratio_of(before: float | None, after: float | None) -> str:
    """Return after / before as text."""
    return fixed(quotient(after, before), 3)


def spread_of(value: Any, decimals: int) -> str:
    """A spread per axis, or one for all of them."""
    if isinstance(value, list):
        return vector(value, decimals, "arcsec", signed=False)
    return fixed(value, decimals, "arcsec")
