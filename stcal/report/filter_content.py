"""What the report of a sequential fit says of its filter, as tables of text."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from stcal.report.content import Table
from stcal.report.document import Document, number, numbers, section, sections, sequence, text
from stcal.report.format import (
    NOT_AVAILABLE,
    count,
    fixed,
    interval,
    measured,
    percent,
    share,
    significant,
    spread,
    words,
    yes_no,
)
from stcal.units import unit_of

# Nobody reads more of these one by one.
_MOST_EVENTS = 30


def is_sequential(document: Document) -> bool:
    """Whether the fit went frame by frame."""
    return bool(section(document, "sequential"))


def filter_tables(document: Document) -> tuple[Table, ...]:
    """The filter; its fallbacks and its decision on temperature where there are any."""
    found = section(document, "sequential")
    tables = [filter_table(found, sequence(document.get("estimated_parameters")))]
    if sections(found.get("events")):
        tables.append(fallback_table(found))
    if section(found, "temperature"):
        tables.append(temperature_table(section(found, "temperature")))
    return tuple(tables)


def filter_table(found: Document, estimated: Sequence[Any]) -> Table:
    """How the filter was set, how its innovations behave, and how it did against the baseline.

    ``found`` is the document's section on the filter, ``estimated`` the parameters' names.
    """
    variant = section(found, "variant")
    precision = f"{words(variant.get('precision'))} precision"
    rows = (
        ("Estimator", f"{words(variant.get('method'))}, {precision}"),
        ("Stars identified with", _camera_of(variant.get("rematch"))),
        ("Process noise", process_noise(variant, estimated)),
        ("Frames / used for an update", _joined((found.get("frames"), found.get("frames_updated")),
                                                count)),
        *_innovation_rows(section(found, "innovations")),
        ("Stars rejected", count(found.get("stars_rejected"))),
        ("Times linearised anew", count(found.get("linearised_anew"))),
        ("Step left to the optimum, largest", fixed(found.get("step_to_optimum_sd"), 2, "sd")),
        *_comparison_rows(found),
        ("Falls back to the baseline", _fallbacks(found, variant.get("shadow"))),
        ("In use at the end", _in_use(found.get("on_baseline"))),
    )  # fmt: skip
    note = (
        "NIS: square of the standardised innovations; 1 per arclength where they agree with their "
        "covariance. Optimum: of all frames at once, the parameters being constants. Baseline: the "
        "initial calibration, which stays on board."
    )
    return Table("The filter", ("", ""), rows, note, numeric=False)


def process_noise(variant: Document, estimated: Sequence[Any]) -> str:
    """Return the random walk of the estimated parameters, those with the same one together."""
    listed = section(variant, "process_noise")
    walks: dict[float, list[str]] = {}
    for name in filter(None, map(text, estimated)):
        walks.setdefault(number(listed.get(name)) or 0.0, []).append(unit_of(name).symbol)
    still = walks.pop(0.0, [])
    if not walks:
        return "none" if still else NOT_AVAILABLE
    if len(walks) == 1 and not still:
        return f"{significant(next(iter(walks)), 3)} sigma per \N{SQUARE ROOT}h, each parameter"
    parts = [f"{', '.join(names)} {significant(walk, 3)}" for walk, names in walks.items()]
    return f"{'; '.join(parts)} sigma per \N{SQUARE ROOT}h"


def fallback_table(found: Document) -> Table:
    """The frames at which the filter started anew from the baseline, and why."""
    events = sections(found.get("events"))
    rows = tuple(
        (count(event.get("frame_id")), words(event.get("time_utc")), words(event.get("event")))
        for event in events[:_MOST_EVENTS]
    )
    note = "The filter started anew from the baseline, which was in use for a window of frames."
    if len(events) > len(rows):
        note = f"The first {len(rows)} of {count(len(events))}. {note}"
    return Table("Fallbacks", ("Frame", "Time", "Reason"), rows, note, numeric=False)


def temperature_table(found: Document) -> Table:
    """Whether the data support parameters that are linear in temperature."""
    evidence, needed = found.get("twice_log_evidence"), found.get("needed")
    slopes = section(found, "slopes_per_k")
    rows = (
        ("Decision", _decision(found.get("chosen"))),
        ("Twice the log evidence", f"{fixed(evidence, 1)} (more than {fixed(needed, 1)} needed)"),
        *(_slope_row(text(name), section(slopes, name)) for name in slopes),
        ("Reference temperature", fixed(found.get("reference_c"), 1, "°C")),
        ("Temperatures seen", interval(found.get("range_c"), 1, unit="°C")),
        ("Frames without temperature", count(found.get("frames_without"))),
    )
    note = (
        "Evidence: logarithm of the Bayes factor of parameters linear in temperature against "
        "constant ones. Slopes: of the linear model, chosen or not, with one sd."
    )
    return Table("Temperature", ("", ""), rows, note, numeric=False)


def _innovation_rows(found: Document) -> tuple[tuple[str, str], ...]:
    level = share(found.get("confidence"))
    nis = (found.get("per_arc"), found.get("scaled_per_arc"))
    return (
        ("Innovations", count(found.get("count"))),
        ("NIS per arc, configured / found noise", _joined(nis, lambda v: fixed(v, 3))),
        ("Noise found / configured", fixed(found.get("noise_scale"), 3)),
        (f"Frames inside the {level} interval of NIS", percent(found.get("within"))),
        ("Correlation of successive innovations", fixed(found.get("lag_one"), 3, signed=True)),
    )


def _comparison_rows(found: Document) -> tuple[tuple[str, str], ...]:
    """Estimate against baseline, each frame judged with the state before it."""
    share, stars = section(found, "availability"), section(found, "matched_stars")
    shares = [share.get(key) for key in ("baseline", "estimate", "used")]
    both = [stars.get(key) for key in ("baseline", "estimate")]
    return (
        ("Frames with a fix, baseline / estimate / used", _joined(shares, percent)),
        ("Matched stars, baseline / estimate", _joined(both, count)),
    )


def _joined(values: Any, show: Callable[[Any], str]) -> str:
    return " / ".join(map(show, values))


def _camera_of(rematch: Any) -> str:
    if not isinstance(rematch, bool):
        return NOT_AVAILABLE
    return "the estimate before each frame" if rematch else "the baseline only (no rematching)"


def _fallbacks(found: Document, shadow: Any) -> str:
    """Whether the filter may fall back, and how often it did."""
    if not isinstance(found.get("events"), list):
        return yes_no(shadow)
    times = len(sequence(found.get("events")))
    word = "fallback" if times == 1 else "fallbacks"
    return f"{yes_no(shadow)}; {count(times) if times else 'no'} {word}"


def _in_use(on_baseline: Any) -> str:
    if not isinstance(on_baseline, bool):
        return NOT_AVAILABLE
    return "the baseline (on probation)" if on_baseline else "the estimate"


def _decision(chosen: Any) -> str:
    if not isinstance(chosen, bool):
        return NOT_AVAILABLE
    return "linear in temperature: chosen" if chosen else "linear in temperature: not supported"


def _slope_row(name: str, slope: Document) -> tuple[str, str]:
    unit = unit_of(name)
    value, sd = numbers([slope.get("value"), slope.get("sd")]) / unit.size
    shown = f"{measured(value, sd, signed=True)} \N{PLUS-MINUS SIGN} {spread(sd)}"
    return f"Slope of {unit.symbol}", f"{shown} {unit.shown}/K".replace(" /K", " 1/K")
