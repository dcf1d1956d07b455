"""What the report of the study ``tracking`` says, as tables of text."""

from __future__ import annotations

from typing import Any

import numpy as np

from stcal.report.content import Table, origin
from stcal.report.document import (
    Document,
    number,
    numbers,
    section,
    sections,
    sequence,
    text,
)
from stcal.report.filter_content import process_noise
from stcal.report.format import (
    NOT_AVAILABLE,
    count,
    fixed,
    percent,
    rms,
    words,
)
from stcal.units import unit_of

VARIANTS = {
    "no_q": "No-Q",
    "q_third": "Q / 3",
    "q": "Q",
    "q_triple": "3 Q",
    "q_all": "Q, all parameters",
    "thermal": "Linear in temperature",
}
_MICRO = 1e-6
_NOTHING = "\N{EN DASH}"
_EXPECTED = ("99.7 %", "68.3 %")
# What follows less of a drift than this isn't late: it does not follow.
_FOLLOWED = 0.5


def case_of(document: Document, name: str) -> Document:
    """Return a case of the study, empty when it is missing."""
    return section(document, "cases", name)


def variants_of(case: Document) -> list[tuple[str, Document]]:
    """Return the labels of a case's variants with their figures, in the order of the report."""
    found = section(case, "variants")
    return [(label, section(found, key)) for key, label in VARIANTS.items() if key in found]


def variant_table(document: Document) -> Table:
    """What each variant is allowed to move."""
    rows = []
    for name, title in (("drift", "Drift"), ("step", "Step")):
        case = case_of(document, name)
        for label, variant in variants_of(case):
            walk = process_noise(variant, list(section(case, "sigma")))
            linear = ", ".join(
                unit_of(text(p)).symbol for p in sequence(variant.get("temperature"))
            )
            rows.append((f"{title}: {label}", walk, linear or "none"))
    note = (
        "The process noise Q was chosen by experiment: the walk with the least error on the drift. "
        "A third and three times of it show its effect."
    )
    header = ("Variant", "Process noise", "Linear in temperature")
    return Table("The variants", header, tuple(rows), note, numeric=False)


def drift_table(document: Document) -> Table:
    """How each variant follows the focal length, frame by frame."""
    case = case_of(document, "drift")
    header = ("Focal length", "Within 3 sd", "Within 1 sd", "Rms error [µm]", "Rms of error / sd",
              "Followed", "Late [s]", "RMS [µrad]", "RMS / true", "Fallbacks")  # fmt: skip
    true = rms(case.get("true_rms_urad"))
    rows: list[tuple[str, ...]] = [
        ("Expected", *_EXPECTED, _NOTHING, "1", "100 %", "0", true, "1", "0")
    ]
    for label, variant in variants_of(case):
        found, follows = _figures(variant, "f_m"), section(variant, "following", "f_m")
        rows.append(
            (
                label,
                *_shares(found),
                _in(found.get("rms"), _MICRO),
                fixed(found.get("rms_z"), 2),
                percent(follows.get("part")),
                _lateness(follows),
                *_fit_cells(variant),
            )
        )
    return Table("Following a drift", header, tuple(rows), _drift_note(case))


def _drift_note(case: Document) -> str:
    return (
        f"Frames after the first {count(case.get('settled_frames'))}. Followed: part of the focal "
        "length's variation that the estimate shows; late: by how much, least squares over the "
        "frames, with the sd of the mean over the runs. RMS: arclength error of each frame with "
        "the estimate before it, over the same star pairs for all."
    )


def step_table(document: Document) -> Table:
    """How each variant comes back after the step, frame by frame."""
    case = case_of(document, "step")
    header = ("Variant", "f: frames until within 3 sd", "f within 3 sd", "f rms error [µm]",
              "m0: frames until within 3 sd", "m0 within 3 sd", "m0 rms error [px]", "RMS [µrad]",
              "RMS / true", "Fallbacks")  # fmt: skip
    expected = (_NOTHING, _EXPECTED[0], _NOTHING)
    true = rms(case.get("true_rms_urad"))
    rows: list[tuple[str, ...]] = [("Expected", *expected, *expected, true, "1", "0")]
    for label, variant in variants_of(case):
        cells: list[str] = []
        for name, size in (("f_m", _MICRO), ("m0_px", 1.0)):
            found, back = _figures(variant, name), section(variant, "back_after").get(name)
            cells += [_frames(back), _shares(found)[0], _in(found.get("rms"), size)]
        rows.append((label, *cells, *_fit_cells(variant)))
    note = (
        "Frames until the truth is within 3 sd and stays there, in the best and the worst run. "
        f"Shares and errors after the first {count(case.get('settled_frames'))} frames, those just "
        "after the step included."
    )
    return Table("After a step", header, tuple(rows), note)


def parameter_table(document: Document, name: str) -> Table:
    """Shares of frames within 3 and 1 sd of every parameter and variant."""
    case = case_of(document, name)
    variants = variants_of(case)
    names = list(section(case, "sigma"))
    rows = tuple(
        (unit_of(text(p)).symbol, *(" / ".join(_shares(_figures(v, p))) for _, v in variants))
        for p in names
    )
    note = (
        "Within 3 sd / within 1 sd; 99.7 % and 68.3 % expected. A parameter without process noise "
        "has one error for the whole run: its shares rest on as many samples as there are runs, "
        f"here {count(document.get('runs'))}."
    )
    header = ("Truth in the band", *(label for label, _ in variants))
    return Table(f"Every parameter, {name}", header, rows, note)


def temperature_table(document: Document) -> Table:
    """The decision on parameters linear in temperature, run by run."""
    rows = []
    for name, title in (("drift", "Drift"), ("constant", "Constant camera")):
        case = section(document, "temperature", name)
        for decision in sections(case.get("decisions")):
            rows.append((title, *_decision_cells(case, decision)))
    header = ("Run", "Temperature [°C]", "True slope of f [µm/K]", "Slope of f [µm/K]",
              "Twice log evidence", "Needed", "Chosen")  # fmt: skip
    note = (
        "Evidence: logarithm of the Bayes factor of a focal length linear in the telemetered "
        "temperature against a constant one, without process noise."
    )
    return Table("Temperature model", header, tuple(rows), note)


def _decision_cells(case: Document, decision: Document) -> tuple[str, ...]:
    slope = section(decision, "slopes_per_k", "f_m")
    low, high = (*numbers(decision.get("range_c")), *2 * (np.nan,))[:2]
    chosen = decision.get("chosen")
    return (
        f"{fixed(low, 0)} to {fixed(high, 0)}" if np.isfinite([low, high]).all() else NOT_AVAILABLE,
        _in(section(case, "true_slopes_per_k").get("f_m"), _MICRO),
        f"{_in(slope.get('value'), _MICRO, 3)} ± {_in(slope.get('sd'), _MICRO, 3)}",
        fixed(decision.get("twice_log_evidence"), 1),
        fixed(decision.get("needed"), 0),
        {True: "yes", False: "no"}.get(chosen, NOT_AVAILABLE)
        if isinstance(chosen, bool)
        else NOT_AVAILABLE,
    )


def settings_table(document: Document) -> Table:
    """What the numbers rest on."""
    first, runs = number(document.get("seed")), number(document.get("runs"))
    seeds = NOT_AVAILABLE
    if first is not None and runs is not None:
        seeds = count(first) if runs <= 1 else f"{count(first)} to {count(first + runs - 1)}"
    rows = (
        ("Sensors", words(document.get("sensor_id"))),
        ("Seeds of the simulation", seeds),
        *(
            (f"Frames, {name}", count(case_of(document, name).get("frames")))
            for name in ("drift", "step")
        ),
        ("Time between frames", fixed(case_of(document, "drift").get("sample_period_s"), 0, "s")),
        ("Filter", "square-root EKF (sqrf), with the watch"),
        *origin(document),
    )
    return Table("The study", ("", ""), rows, numeric=False)


def _figures(variant: Document, name: str) -> Document:
    return section(variant, "parameters", name)


def _shares(found: Document) -> tuple[str, str]:
    return percent(found.get("within_3sd")), percent(found.get("within_1sd"))


def _fit_cells(variant: Document) -> tuple[str, str, str]:
    return (
        rms(variant.get("rms_urad")),
        fixed(variant.get("rms_ratio"), 3),
        count(variant.get("fallbacks")),
    )


def _in(value: Any, size: float, decimals: int = 2) -> str:
    found = number(value)
    return fixed(None if found is None else found / size, decimals)


def _lateness(follows: Document) -> str:
    """Return the mean lag of the runs, with its sd where there are several."""
    found, part = numbers(follows.get("lag_s")), number(follows.get("part"))
    if part is None or not len(found) or not np.isfinite(found).all():
        return NOT_AVAILABLE
    if part < _FOLLOWED:
        return _NOTHING
    if len(found) == 1:
        return fixed(float(found[0]), 0)
    sd = float(found.std(ddof=1) / np.sqrt(len(found)))
    return f"{fixed(float(found.mean()), 0)} ± {fixed(sd, 0)}"


def _frames(runs: Any) -> str:
    """Return best and worst of the runs; ``never`` where one is not back."""
    found = [number(value) for value in sequence(runs)]
    if not found:
        return NOT_AVAILABLE
    back = sorted(value for value in found if value is not None)
    if not back:
        return "never"
    worst = count(back[-1]) if len(back) == len(found) else "never"
    return worst if worst == count(back[0]) else f"{count(back[0])} to {worst}"
