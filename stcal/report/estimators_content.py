"""What the report of the study ``estimators`` says, as tables of text, and the answer in words."""

from __future__ import annotations

from stcal.report.content import (
    Table,
    origin,
    quotient,
)
from stcal.report.document import Document, number, numbers, section, sections, sequence, text
from stcal.report.format import (
    NOT_AVAILABLE,
    count,
    fixed,
    percent,
    share,
    significant,
    words,
)

KINDS = ("starts", "false_matches")
_KB, _NOT_RUN = 1e3, "\N{EN DASH}"
PLACES = {"ground": "On the ground", "on_board": "On board, with memory that does not grow"}
_EVERYWHERE = "On the ground and on board alike"


def combination_of(row: Document) -> str:
    """Return a combination's name: ``direction / sqrf``."""
    return f"{words(row.get('residual'))} / {words(row.get('estimator'))}"


def sensors(document: Document) -> list[Document]:
    """Return the sensors of the study."""
    found = section(document, "sensors")
    return [section(found, name) for name in found]


def answer(document: Document) -> list[str]:
    """Return which combination to use, in sentences made of the numbers."""
    chosen = section(document, "choice")
    rows = {label: section(chosen, place) for place, label in PLACES.items()}
    ground, on_board = rows.values()
    if ground and ground == on_board:
        rows = {_EVERYWHERE: ground}
    recommended = [_recommended(row, label) for label, row in rows.items()]
    return [*recommended, *_spread(document), *_avoided(document)]


def _recommended(row: Document, place: str) -> str:
    if not row:
        return f"{place}: no combination met the rule in this run."
    return (
        f"{place}, use {words(row.get('estimator'))} with {words(row.get('residual'))}: on the "
        f"worst camera its error is {fixed(row.get('over_efficient'))} times that of an efficient "
        f"estimate and its errors over sd {fixed(row.get('honesty'))} times, it takes "
        f"{count(row.get('us_per_frame'))} µs a frame, and {share(row.get('robust'))} of "
        "the runs with bad starts or false matches end well."
    )


def _spread(document: Document) -> list[str]:
    """Return how much residual and estimator decide."""
    rows, spread = summaries(document), {}
    for key in ("residual", "estimator"):
        least = [_least(own, "over_efficient") for own in _groups(rows, key).values()]
        known = [value for value in least if value is not None]
        if not known:
            return []
        spread[key] = max(known) / min(known) - 1.0
    return [
        f"The {max(spread, key=lambda key: spread[key])} decides on accuracy: the best of each "
        f"residual differ by {percent(spread['residual'])}, the best of each estimator by "
        f"{percent(spread['estimator'])}."
    ]


def _avoided(document: Document) -> list[str]:
    """Return which residuals are never eligible, which other combinations were refused, and why."""
    rules = section(document, "choice", "rule")
    reasons = []
    for name, own in _groups(summaries(document), "residual").items():
        why = _never_eligible(own, rules)
        if why:
            reasons.append(f"{name} ({why})")
            continue
        refused = [row for row in own if number(row.get("refused"))]
        reasons += [f"{combination_of(r)} ({count(r.get('refused'))} refused)" for r in refused]
    return [f"Not to be preferred: {', '.join(reasons)}."] if reasons else []


def _never_eligible(rows: list[Document], rules: Document) -> str:
    """Return why none of a residual's combinations is accurate and honest; empty if one is."""
    figures = (
        ("over_efficient", "accurate", "error over the efficient estimate's"),
        ("honesty", "honest", "errors over sd"),
    )
    found = [(label, _least(rows, key), number(rules.get(limit))) for key, limit, label in figures]
    return "; ".join(
        f"{label} {fixed(value)}"
        for label, value, limit in found
        if value is not None and limit is not None and value > limit
    )


def summaries(document: Document) -> list[Document]:
    """Return the combinations with their worst figures."""
    return sections(section(document, "choice").get("summaries"))


def _groups(rows: list[Document], key: str) -> dict[str, list[Document]]:
    """Return the rows of each residual, or of each estimator."""
    found: dict[str, list[Document]] = {}
    for row in rows:
        found.setdefault(text(row.get(key)), []).append(row)
    return found


def _least(rows: list[Document], key: str) -> float | None:
    known = [value for row in rows if (value := number(row.get(key))) is not None]
    return min(known, default=None)


def whole_table(document: Document) -> Table:
    """All combinations of camera, residual and estimator; robustness is that of one camera."""
    header = (
        "Camera", "Residual", "Estimator", "Error / bound", "Errors / sd", "µs a frame",
        "Kept [kB]",
        *(f"{significant(k, 3)} σ off" for k in conditions(document, "start_sigma")),
        *(f"{share(k)} false" for k in conditions(document, "false_shares")),
    )  # fmt: skip
    rows = [
        _whole_row(camera, item, robust)
        for camera in sensors(document)
        for item, robust in _beside(document, camera)
    ]
    return Table("All combinations", header, tuple(rows), _whole_note(document))


def conditions(document: Document, key: str) -> list[float]:
    """Return the bad starts [sigma] (``start_sigma``) or shares of false matches."""
    return [float(value) for value in numbers(section(document, "robustness").get(key))]


def _beside(document: Document, camera: Document) -> list[tuple[Document, list[str]]]:
    """Return a camera's combinations with the cells that say how robust they are."""
    robust = section(document, "robustness")
    found = sections(camera.get("combinations"))
    if camera.get("sensor_id") != robust.get("sensor_id"):
        blank = sum(len(conditions(document, key)) for key in ("start_sigma", "false_shares"))
        return [(item, [_NOT_RUN] * blank) for item in found]
    return [
        (
            item,
            [share(v) for kind in KINDS for v in sequence(section(row, kind).get("well"))],
        )
        for item, row in zip(found, sections(robust.get("combinations")), strict=False)
    ]


def _whole_row(camera: Document, item: Document, robust: list[str]) -> tuple[str, ...]:
    return (
        words(camera.get("camera")),
        words(item.get("residual")),
        words(item.get("estimator")),
        _error(item),
        fixed(item.get("error_over_sd")),
        count(item.get("us_per_frame")),
        count(quotient(item.get("kept_bytes"), _KB)),
        *robust,
    )


def _whole_note(document: Document) -> str:
    efficient = ", ".join(fixed(c.get("efficient_over_bound")) for c in sensors(document))
    return (
        "Error / bound: rms error of directions over the detector, over what the centroids allow, "
        "with the number of refused fits in parentheses; by the luck of these runs the efficient "
        f"estimate has {efficient or NOT_AVAILABLE}. Errors / sd: rms over parameters and runs. "
        "Kept: what a fit must hold, which grows with the frames for batch. Last columns: runs "
        f"that end within {significant(document.get('well'), 3)} times the bound, from a start so "
        f"many sigma off and with so many false matches; measured on one camera."
    )


def _error(item: Document) -> str:
    refused = number(item.get("refused"))
    shown = fixed(item.get("over_bound"))
    return f"{shown} ({count(refused)})" if refused else shown


def summary_table(document: Document) -> Table:
    """The combinations with their worst figures, by which the rule chooses."""
    rows = tuple(
        (
            combination_of(row),
            fixed(row.get("over_efficient")),
            fixed(row.get("honesty")),
            count(row.get("us_per_frame")),
            count(row.get("refused")),
            percent(row.get("robust")),
            "yes" if row.get("eligible") is True else "no",
        )
        for row in summaries(document)
    )
    header = ("Residual / estimator", "Error / efficient", "Errors / sd / efficient",
              "µs a frame", "Refused", "End well", "Eligible")  # fmt: skip
    return Table("The figures that decide", header, rows, rule(document))


def rule(document: Document) -> str:
    """Return the rule in words."""
    limits = section(document, "choice", "rule")
    accurate, honest, fast = (fixed(limits.get(k), 2) for k in ("accurate", "honest", "fast"))
    return (
        f"Eligible: on every camera at most {accurate} times the efficient estimate's error and "
        f"{honest} times its errors over sd, no run refused. Of the eligible, those as robust as "
        f"the most robust within {significant(limits.get('robust'), 2)} × the standard error of "
        "the difference (all runs with bad starts or false matches together); of these, the "
        f"fastest (geometric mean over cameras); within {fast} times its time, square-root forms "
        "come first. The efficient estimate, one least-squares step with all the information from "
        "the true camera, takes the luck of the runs out."
    )


def camera_rows(document: Document) -> list[tuple[str, str]]:
    """Each camera by name, with its stars and its bound."""
    return [
        (
            f"{words(camera.get('camera'))}, {words(camera.get('name'))}",
            f"{fixed(camera.get('stars'), 1)} stars an exposure; bound "
            f"{fixed(camera.get('bound_urad'), 1)} µrad, the camera on board errs by "
            f"{fixed(camera.get('initial_over_bound'), 0)} times that",
        )
        for camera in sensors(document)
    ]


def settings_table(document: Document) -> Table:
    """What the numbers depend on."""
    rows: list[tuple[str, ...]] = [
        ("Runs", count(document.get("runs"))),
        ("Runs under each bad start and share of false matches",
         count(section(document, "robustness").get("runs"))),
        ("Frames of a run", count(document.get("frames"))),
        ("Seed", count(document.get("seed"))),
    ]  # fmt: skip
    rows += camera_rows(document)
    rows.append(("Machine", words(document.get("machine"))))
    return Table("The study", ("", ""), (*rows, *origin(document)), numeric=False)
