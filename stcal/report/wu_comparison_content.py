"""What the report of the study ``wu`` says beyond the paper: bounds, who wins, what B implies."""

from __future__ import annotations

import numpy as np

from stcal.report.content import Table, origin, quotient
from stcal.report.document import Document, numbers, section, sections, text
from stcal.report.format import NOT_AVAILABLE, count, fixed, percent, significant, words
from stcal.report.wu_content import (
    AD,
    GROUPS,
    LABELS,
    SVD,
    expectation,
    group_of,
    method_of,
    over_runs,
    plus_minus,
)
from stcal.units import unit_of


def bound_table(document: Document) -> Table:
    """How near the filters come to what the data allow."""
    rows = []
    for group in GROUPS:
        here = group_of(document, group)
        compared = section(document, "comparison", "against_bound", group)
        ad, svd = section(compared, AD), section(compared, SVD)
        rows.append(
            (
                f"{group} ({significant(here.get('stars'), 3)} stars)",
                expectation(section(here, "bound")),
                over_runs(section(here, "efficient").get("mean"), 3),
                _ratio(ad),
                _ratio(svd),
                fixed(svd.get("expected"), 3),
            )
        )
    header = ("Group", 'Bound ["]', 'Efficient estimate ["]', "AD / efficient", "SVD / efficient",
              "SVD / bound, expected")  # fmt: skip
    note = (
        "Bound: criterion A that the centroids allow, mean over runs (5 to 95 % of the runs). "
        "Efficient estimate: least squares with all the information, from the true camera, on the "
        "same images: it takes the luck of the runs out of the ratios (± standard error). Last "
        "column: what the singular values' own information costs."
    )
    return Table("Against the bound", header, tuple(rows), note)


def _ratio(found: Document) -> str:
    return plus_minus(fixed(found.get("ratio"), 3), fixed(found.get("sd"), 3))


def win_table(document: Document) -> Table:
    """Whether the singular values win anything against the angular distances."""
    rows = tuple(
        (
            f"{text(row.get('what'))}, group {text(row.get('group'))}",
            *(_won(row, method) for method in LABELS),
            LABELS.get(text(row.get("winner")), text(row.get("winner"))),
        )
        for row in wins(document)
    )
    header = ("", "AD", "SVD", "Better")
    note = (
        'Accuracy and sd: criterion A ["]; a method is better beyond two standard errors of the '
        "difference over the runs. Time [µs per image]: by more than 5 %."
    )
    return Table("Do the singular values win anything?", header, rows, note)


def wins(document: Document) -> list[Document]:
    """Return the document's comparisons of the two methods."""
    return sections(section(document, "comparison").get("wins"))


def _won(row: Document, method: str) -> str:
    return fixed(row.get(method), 1 if row.get("what") == "time" else 3)


def published_table(document: Document) -> Table:
    """What the published numbers imply."""
    rows = []
    for group in GROUPS:
        found = section(document, "comparison", "published", group)
        for method, label in LABELS.items():
            item = section(found, method)
            cells = (fixed(item.get(key)) for key in ("over_bound", "over_bound_at_noise"))
            noise = fixed(found.get("noise_px"), 3)
            rows.append((f"{group}, {label}", *cells, percent(item.get("luck")), noise))
    header = ("Group, method", "A / bound, stated noise", "A / bound, shown noise",
              "Runs as good, stated noise", "Noise that B shows [px]")  # fmt: skip
    note = (
        "The paper states 0.5 px of noise per axis, with which separations err by "
        f'{_all_b(document)} " (criterion B here); its own criterion B is 10.6 to 10.9 ", which '
        "belongs to the noise of the last column. Runs as good: the share of single runs at the "
        "bound, with the stated noise, whose criterion A is as small as the published one. The "
        "bound is that of the paper's number of images."
    )
    return Table("What the published numbers imply", header, tuple(rows), note)


def _all_b(document: Document) -> str:
    runs = [numbers(section(method_of(document, g, AD), "b").get("mean")) for g in GROUPS]
    means = [float(found.mean()) for found in runs if len(found) and np.isfinite(found).all()]
    return f"{fixed(min(means), 1)} to {fixed(max(means), 1)}" if means else NOT_AVAILABLE


def settings_table(document: Document) -> Table:
    """What the numbers depend on."""
    settings = section(document, "settings")
    parameters = section(settings, "parameters")
    rows: list[tuple[str, ...]] = [
        ("Runs", count(document.get("runs"))),
        ("Seed", count(document.get("seed"))),
        ("Images to calibrate with", count(settings.get("calibration_images"))),
        ("Images to judge by", count(settings.get("evaluation_images"))),
        ("Centroid noise per axis", fixed(settings.get("noise_sd_px"), 2, "px")),
        ("Attitudes", "random, uniform over all orientations"),
        *(_limit_row(document, group) for group in GROUPS),
        ("Filter", "square-root EKF (sqrf), no process noise, stars given"),
    ]
    for name in section(parameters, "true"):
        unit = unit_of(name)
        true, initial, sd = (
            significant(quotient(section(parameters, key).get(name), unit.size), 6)
            for key in ("true", "initial", "prior_sd")
        )
        rows.append((unit.label, f"true {true}, initial {initial}, prior sd {sd}"))
    rows.append(("Machine", words(settings.get("machine"))))
    return Table("The study", ("", ""), (*rows, *origin(document)), numeric=False)


def _limit_row(document: Document, group: str) -> tuple[str, str]:
    limits = section(document, "settings", "limiting_magnitudes")
    here, paper = group_of(document, group), section(document, "paper", "groups", group)
    return (
        f"Limiting magnitude, group {group}",
        f"{fixed(limits.get(group))}: {fixed(here.get('stars'), 1)} stars (paper "
        f"{fixed(paper.get('stars'), 1)}); the paper's {fixed(paper.get('limiting_magnitude'), 1)} "
        f"shows {fixed(here.get('stars_at_paper_magnitude'), 1)}",
    )
