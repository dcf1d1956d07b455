"""What the report of the study ``wu`` says: Tables 2 to 4, the paper's values beside ours.

Ours are means over the runs, with the sd over the runs; beside them what the data allow.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stcal.report.content import Table
from stcal.report.document import Document, Floats, numbers, section
from stcal.report.format import (
    NOT_AVAILABLE,
    count,
    fixed,
    rms,
    significant,
    words,
)
from stcal.units import unit_of

AD, SVD = "ad", "svd"
LABELS = {AD: "AD", SVD: "SVD"}
GROUPS = ("1", "2", "3")
# Columns of Tables 2 and 3; both are of group 2.
TESTED = "2"
MODELS = {"model 1": "Model 1", "model 2": "Model 2", "model 3": "Model 3", SVD: "Model 4"}
VALUES = {
    "values 1,2,3": "{σ1,σ2,σ3}",
    SVD: "{σ2,σ3}",
    "values 1,2": "{σ1,σ2}",
    "values 1,3": "{σ1,σ3}",
    "values 1": "{σ1}",
    "values 2": "{σ2}",
    "values 3": "{σ3}",
}
# Decimals of the parameters' errors in percent.
_ERROR_DECIMALS = {"aspect": 4, "f_m": 4, "u0_px": 3, "v0_px": 3, "k1": 3, "k2": 2}

# A column: its heading, the method's results here, and those published.
Column = tuple[str, Document, Document]


def model_table(document: Document) -> Table:
    """Table 2: the four models of star groups."""
    columns = _columns(document, TESTED, MODELS)
    rows = []
    for name, decimals in _ERROR_DECIMALS.items():
        label = f"Δ{unit_of(name).symbol} [%]"
        published = [_error(paper, name, decimals) for _, _, paper in columns]
        rows.append((f"{label}, paper", *published))
        rows.append((f"{label}, stcal", *(_errors(here, name, decimals) for _, here, _ in columns)))
    rows += _accuracy_rows(columns)
    title = "Table 2. Calibration by models of star groups, {σ2,σ3}, group 2"
    return Table(title, _header("", columns), tuple(rows), _accuracy_note(document))


def _error(paper: Document, name: str, decimals: int) -> str:
    return fixed(section(paper, "error_percent").get(name), decimals, signed=True)


def _errors(here: Document, name: str, decimals: int) -> str:
    return over_runs(section(here, "error_percent").get(name), decimals, signed=True)


def _accuracy_note(document: Document) -> str:
    return (
        f"stcal: mean over {count(document.get('runs'))} runs (errors: ± sd over runs); the "
        "paper's is one run. A mean, A sd: criterion A's mean and sd over the last images. "
        "Expected: mean over runs that the values' own information allows, with their full "
        "covariance. Constant R: the same values weighed alike, by least squares on "
        "the same images. The order of an image's stars, which makes the groups, is here that of "
        "brightness; the paper doesn't give its own."
    )


def value_table(document: Document) -> Table:
    """Table 3: combinations of singular values."""
    columns = _columns(document, TESTED, VALUES)
    rows = [*_accuracy_rows(columns), *_time_rows(columns)]
    note = "As in Table 2. " + _time_note(document)
    title = "Table 3. Calibration by combinations of singular values, model 4, group 2"
    return Table(title, _header("", columns), tuple(rows), note)


def group_table(document: Document) -> Table:
    """Table 4: angular distances against singular values by number of stars."""
    columns = [
        (f"{group}, {heading}", here, paper)
        for group in GROUPS
        for heading, here, paper in _columns(document, group, LABELS)
    ]
    stars = [significant(group_of(document, group).get("stars"), 3) for group in GROUPS]
    bounds = [fixed(section(group_of(document, g), "bound").get("mean"), 3) for g in GROUPS]
    rows = [
        ("Stars", *(cell for value in stars for cell in (value, value))),
        ('A mean ["], bound', *(cell for value in bounds for cell in (value, value))),
        *_accuracy_rows(columns),
        *_pair_of_rows('B mean ["]', columns, "b", "mean"),
        *_pair_of_rows('B sd ["]', columns, "b", "sd"),
        *_time_rows(columns),
    ]
    title = "Table 4. Angular distances (AD) and singular values (SVD)"
    return Table(title, _header("Group, method", columns), tuple(rows), _group_note(document))


def _group_note(document: Document) -> str:
    growth = section(document, "comparison", "growth")
    here, paper = section(growth, "here"), section(growth, "paper")
    return (
        "SVD: model 4 with {σ2,σ3}. Bound: the Cramer-Rao bound of the centroids, each image's "
        "attitude projected out. "
        + _time_note(document)
        + f" Between the groups it grows with the number of stars to the power "
        f"{fixed(here.get(AD))} (AD) and {fixed(here.get(SVD))} (SVD), in the paper "
        f"{fixed(paper.get(AD))} and {fixed(paper.get(SVD))}: here AD takes 2 N - 3 separations of "
        "an image, from which all others follow, with a banded factor of their covariance."
    )


def _time_note(document: Document) -> str:
    settings = section(document, "settings")
    return (
        "Time: the filter's pass per image, one thread's own time, once it has settled (second "
        "half of the images; the first ones are filtered again while the estimate moves far), "
        f"median over the runs, {words(settings.get('machine'))}; the paper's is MATLAB on an Intel"
        " Core i5-8300H."
    )


def over_runs(values: object, decimals: int, signed: bool = False) -> str:
    """Return ``mean ± sd`` of the runs' numbers, the mean alone of a single run."""
    mean = mean_over_runs(values, decimals, signed)
    return plus_minus(mean, sd_over_runs(values, decimals))


def mean_over_runs(values: object, decimals: int, signed: bool = False) -> str:
    """Return the mean of the runs' numbers."""
    known = _known(values)
    return fixed(float(known.mean()) if len(known) else None, decimals, signed=signed)


def sd_over_runs(values: object, decimals: int) -> str:
    """Return the sd of the runs' numbers, which a single run doesn't have."""
    known = _known(values)
    return fixed(float(known.std()) if len(known) > 1 else None, decimals)


def _known(values: object) -> Floats:
    found = numbers(values)
    return found[np.isfinite(found)]


def plus_minus(value: str, sd: str) -> str:
    """Return ``value ± sd``, the value alone when either is missing."""
    return value if NOT_AVAILABLE in (value, sd) else f"{value} ± {sd}"


def expectation(distribution: Document) -> str:
    """Return the mean of a distribution and its 5 and 95 % points."""
    mean, points = fixed(distribution.get("mean"), 3), numbers(distribution.get("percentiles"))
    if len(points) != 101 or NOT_AVAILABLE in mean:
        return mean
    return f"{mean} ({fixed(float(points[5]))} to {fixed(float(points[95]))})"


def group_of(document: Document, group: str) -> Document:
    """Return what the document says of a group."""
    return section(document, "groups", group)


def method_of(document: Document, group: str, method: str) -> Document:
    """Return what the document says of a method in a group."""
    return section(group_of(document, group), "methods", method)


def _columns(document: Document, group: str, labels: dict[str, str]) -> list[Column]:
    paper = section(document, "paper", "groups", group, "methods")
    return [
        (label, method_of(document, group, name), section(paper, name))
        for name, label in labels.items()
    ]


def _header(first: str, columns: Sequence[Column]) -> tuple[str, ...]:
    return (first, *(heading for heading, _, _ in columns))


def _accuracy_rows(columns: Sequence[Column]) -> list[tuple[str, ...]]:
    """Criterion A: published, here, what the residual allows, and with a constant R."""
    here = [found for _, found, _ in columns]
    a = [section(found, "a").get("mean") for found in here]
    constant = [section(found, "constant_r").get("mean") for found in here]
    expected = [section(found, "expected").get("mean") for found in here]
    return [
        *_pair_of_rows('A mean ["]', columns, "a", "mean"),
        ('A mean ["], sd over runs', *(sd_over_runs(values, 3) for values in a)),
        ('A mean ["], expected', *(fixed(value, 3) for value in expected)),
        ('A mean ["], constant R', *(mean_over_runs(values, 3) for values in constant)),
        *_pair_of_rows('A sd ["]', columns, "a", "sd"),
    ]


def _pair_of_rows(
    label: str, columns: Sequence[Column], name: str, key: str
) -> list[tuple[str, ...]]:
    """One number of a criterion: the published row above ours."""
    paper = (fixed(section(p, name).get(key), 3) for _, _, p in columns)
    here = (mean_over_runs(section(h, name).get(key), 3) for _, h, _ in columns)
    return [(f"{label}, paper", *paper), (f"{label}, stcal", *here)]


def _time_rows(columns: Sequence[Column]) -> list[tuple[str, ...]]:
    paper = (rms(p.get("us_per_image")) for _, _, p in columns)
    here = (rms(h.get("us_settled")) for _, h, _ in columns)
    return [("Time [µs / image], paper", *paper), ("Time [µs / image], stcal", *here)]
