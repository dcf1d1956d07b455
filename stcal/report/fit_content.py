"""What the report of a fit says, as tables of text."""

from __future__ import annotations

from typing import Any

from stcal.report.content import (
    Table,
    field_rms,
    matrix_rows,
    origin,
    quotient,
    ratio_of,
    spread_of,
)
from stcal.report.document import (
    Document,
    number,
    section,
    sections,
    sequence,
    text,
)
from stcal.report.filter_content import is_sequential
from stcal.report.format import (
    count,
    fixed,
    measured,
    percent,
    rms,
    significant,
    spread,
    vector,
    words,
    yes_no,
)
from stcal.units import unit_of

_BOTH = ("initial", "fitted")
_NOTHING = "\N{EN DASH}"


def fit_summary(document: Document) -> Table:
    """Before and after the fit, on the calibration data."""
    errors, frames = section(document, "rms_urad"), number(document.get("frames"))
    before, after = number(errors.get("initial")), number(errors.get("fitted"))
    rows = [("Common-pair RMS [µrad]", rms(before), rms(after), ratio_of(before, after))]
    shares = [_per_frame(document, "frames_solved", which, frames) for which in _BOTH]
    rows.append(("Frames with a fix", percent(shares[0]), percent(shares[1]), ratio_of(*shares)))
    stars = [_per_frame(document, "matched_stars", which, frames) for which in _BOTH]
    rows.append(("Matched stars per frame", fixed(stars[0]), fixed(stars[1]), ratio_of(*stars)))
    fields = [field_rms(document, which) for which in ("before", "after")]
    rows.append(
        (
            "Mean residual field, RMS [px]",
            fixed(fields[0], 3),
            fixed(fields[1], 3),
            ratio_of(*fields),
        )
    )
    header = ("On the calibration data", "Initial", "Fitted", "Fitted / initial")
    note = "Matched stars: both exposures together."
    return Table("Before and after", header, tuple(rows), note)


def fit_facts(document: Document) -> Table:
    """What was fitted, with what."""
    noise, span = section(document, "noise"), section(document, "span")
    sequential = is_sequential(document)
    settled = () if sequential else (("Matched set settled", yes_no(document.get("settled"))),)
    rows = (
        ("Sensor", words(document.get("sensor_id"))),
        ("Method", " / ".join(words(document.get(key)) for key in ("method", "residual"))),
        ("Matches" if sequential else "Matches of the first cycle", words(document.get("matches"))),
        ("Time span", f"{words(span.get('from'))} to {words(span.get('to'))}"),
        ("Frames", count(document.get("frames"))),
        ("Exposures used", count(document.get("exposures_used"))),
        ("Stars used", count(document.get("stars_used"))),
        ("Residuals", count(document.get("residuals"))),
        ("Detector coverage", percent(document.get("coverage"))),
        *settled,
        ("Centroid noise, sd", fixed(noise.get("sd_px"), 3, "px")),
        ("Noise found / assumed", fixed(noise.get("scale"), 3)),
        *origin(document),
    )
    return Table("The fit", ("", ""), rows, numeric=False)


def cycle_table(document: Document) -> Table:
    """One row per cycle of rematching."""
    header = ("Cycle", "Matching", "Frames solved", "Exposures solved", "Matched stars",
              "Matches changed", "Stars fitted", "Iterations", "RMS [µrad]", "chi² / dof",
              "Noise scale", "Stars rejected", "Largest change [sd]")  # fmt: skip
    rows = tuple(
        (
            count(cycle.get("cycle")),
            words(cycle.get("matching")),
            *(count(cycle.get(key)) for key in ("frames_solved", "exposures_solved",
              "matched_stars", "matches_changed", "stars_fitted", "iterations")),
            rms(cycle.get("rms_urad")),
            fixed(quotient(cycle.get("chi2"), cycle.get("dof")), 3),
            fixed(cycle.get("noise_scale"), 3),
            count(cycle.get("stars_rejected")),
            significant(cycle.get("change_sd"), 2),
        )
        for cycle in sections(document.get("cycles"))
    )  # fmt: skip
    return Table("Cycles", header, rows)


def parameter_table(document: Document) -> Table:
    """Parameters in readable units with sd and change."""
    header = ("Parameter", "Initial", "Fitted", "sd", "Change", "Change [sigma]",
              "Change [sd]")  # fmt: skip
    note = (
        "sigma: spread of the parameter from unit to unit (sensor configuration, as in Enright "
        "2018 Table II). sd: one-sigma uncertainty of the fit."
    )
    rows = tuple(
        _held_row(item) if is_held(item, document) else _parameter_row(item)
        for item in sections(document.get("parameters"))
    )
    return Table("Parameters", header, rows, note)


def is_held(item: Document, document: Document) -> bool:
    """Whether a row of the document's parameters is one that was not estimated."""
    estimated = sequence(document.get("estimated_parameters"))
    return bool(estimated) and item.get("sd") is None and item.get("name") not in estimated


def observability_table(document: Document) -> Table:
    """Condition and the sentence on what the data hardly show."""
    condition = section(document, "condition")
    rows = (
        ("Observability", words(document.get("observability"))),
        ("Condition number, parameters in SI units", significant(condition.get("raw"), 3)),
        ("Condition number, scaled parameters", significant(condition.get("scaled"), 4)),
    )
    return Table("Observability", ("", ""), rows, numeric=False)


def c_sd_table(document: Document) -> Table:
    """The alignment update."""
    update = section(document, "c_sd")
    rows = (
        ("Offset removed, x y z", vector(update.get("offset_arcsec"), 2, "arcsec")),
        ("Spread over frames, x y z", spread_of(update.get("spread_arcsec"), 2)),
        ("sd of the mean", spread_of(update.get("sd_of_mean_arcsec"), 3)),
        ("Frames used", count(update.get("frames_used"))),
        ("Frames left out as outliers", count(update.get("frames_rejected"))),
        *matrix_rows("C_SD", update.get("matrix")),
    )
    return Table("Alignment update (C_SD)", ("", ""), rows, numeric=False)


def _held_row(item: Document) -> tuple[str, ...]:
    unit = unit_of(text(item.get("name")))
    values = (significant(_in_unit(item.get(key), unit.size), 6) for key in _BOTH)
    return (unit.label, *values, "held", *3 * (_NOTHING,))


def _parameter_row(item: Document) -> tuple[str, ...]:
    unit = unit_of(text(item.get("name")))
    keys = ("initial", "fitted", "sd", "change")
    initial, fitted, sd, change = (_in_unit(item.get(key), unit.size) for key in keys)
    return (
        unit.label,
        measured(initial, sd),
        measured(fitted, sd),
        spread(sd),
        measured(change, sd, signed=True),
        fixed(item.get("change_sigma"), 2, signed=True),
        fixed(item.get("change_sd"), 1, signed=True),
    )


def _in_unit(value: Any, size: float) -> float | None:
    found = number(value)
    return None if found is None else found / size


def _per_frame(document: Document, what: str, which: str, frames: float | None) -> float | None:
    found = number(section(document, what).get(which))
    return None if found is None or not frames else found / frames
