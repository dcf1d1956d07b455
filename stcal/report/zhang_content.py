"""What the report of the study ``zhang`` says of the first stage, published values beside ours."""

from __future__ import annotations

import numpy as np

from stcal.report.content import Table, quotient
from stcal.report.document import Document, number, numbers, section, sections
from stcal.report.format import NOT_AVAILABLE, count, fixed, significant
from stcal.units import unit_of

PAPER, OURS = "ukf_cosine", "sqrf_arclength"
FILTERS = {
    PAPER: "UKF, inner products (paper's)",
    "ukf_arclength": "UKF, arclengths",
    OURS: "SQRF, arclengths",
    "sqrf_direction": "SQRF, directions",
}
SHORT = {PAPER: "Paper's filter", OURS: "SQRF, arclengths"}
NAMES = ("x0_px", "y0_px", "f_m", "k1_per_px2", "k2_per_px4")
# As the paper gives the averages.
_DECIMALS = dict(zip(NAMES, (2, 2, 3, 2, 3), strict=True))
_CASES = {
    "common": "displacement of the image",
    "field": "distortion of the field",
    "both": "both",
}


def value_of(group: Document, name: str, digits: int = 2) -> str:
    """Return one parameter's value of a group by name, in its shown unit."""
    return significant(quotient(group.get(name), unit_of(name).size), digits)


def error_table(document: Document) -> Table:
    """Table 3: the errors after 300 s."""
    errors, paper = section(document, "errors"), section(document, "paper")
    of_paper, of_ours = (section(errors, "filters", name) for name in (PAPER, OURS))
    columns = (
        ("Published", section(paper, "error")),
        ("Averaged curve", _absolute(section(of_paper, "averaged"))),
        ("Mean of runs", section(of_paper, "absolute")),
        ("RMS", section(of_paper, "rms")),
        ("Filter's own sd", section(of_paper, "sd")),
        ("RMS, SQRF", section(of_ours, "rms")),
        ("Bound of one run", section(errors, "bound")),
    )
    rows = [
        (unit_of(name).label, *(value_of(group, name) for _, group in columns)) for name in NAMES
    ]
    header = (f"Error after {fixed(errors.get('t_s'), 0, 's')}", *(title for title, _ in columns))
    title = "Table 3. Errors of the parameters"
    return Table(title, header, tuple(rows), _error_note(document))


def _absolute(group: Document) -> Document:
    found = {name: number(value) for name, value in group.items()}
    return {name: None if value is None else abs(value) for name, value in found.items()}


def _error_note(document: Document) -> str:
    runs, paper = count(document.get("runs")), section(document, "paper")
    return (
        f"Averaged curve: the error of the paper's filter averaged over {runs} runs, which is what "
        f"the paper tells of its {count(paper.get('runs'))}. Mean of runs: the mean absolute error "
        "of single runs. SQRF: the square-root filter on arclengths with their covariance. Bound: "
        "the Cramer-Rao bound on the sd of one run, from the centroids with each image's attitude "
        f"projected out and the filters' prior; an average of {count(paper.get('runs'))} runs has "
        "a tenth of it."
    )


def filter_table(document: Document) -> Table:
    """RMS error over the bound and over the filter's own sd, of every filter."""
    rows = []
    for name, label in FILTERS.items():
        found = section(document, "errors", "filters", name)
        for key, told in (("over_bound", "RMS / bound"), ("consistency", "RMS / own sd")):
            group = section(found, key)
            rows.append((f"{label}: {told}", *(fixed(group.get(n)) for n in NAMES)))
    header = ("After 300 s", *(unit_of(name).symbol for name in NAMES))
    note = (
        "Inner products and arclengths are of the same 2 N - 3 pairs of an image's N stars (the "
        "paper takes the products of all pairs); directions have the attitude projected out. "
        "1 is expected of an efficient filter with a right sd. The values of one row are "
        "correlated; each scatters by "
        f"{significant(_scatter(document), 1)} over so many runs."
    )
    return Table("Filters and measurements", header, tuple(rows), note)


def _scatter(document: Document) -> float | None:
    """Return the sd of an RMS of so many normal errors, as a share."""
    runs = number(document.get("runs"))
    return 1.0 / np.sqrt(2.0 * runs) if runs and runs > 0.0 else None


def convergence_table(document: Document) -> Table:
    """When the curves have converged, and their averages over the whole time."""
    filters = section(document, "convergence", "filters")
    published = section(document, "paper", "average")
    true = section(document, "settings", "parameters", "true")
    rows = []
    for name in NAMES:
        cells = [
            fixed(section(filters, f, "converged", kind).get(name), 0)
            for f in (PAPER, OURS)
            for kind in ("averaged", "absolute")
        ]
        averages = [
            fixed(quotient(group.get(name), unit_of(name).size), _DECIMALS[name])
            for group in (published, section(filters, PAPER, "time_average"), true)
        ]
        rows.append((unit_of(name).label, *cells, *averages))
    header = ("", "Paper's filter, averaged [s]", "Single runs [s]", "SQRF, averaged [s]",
              "Single runs [s]", "Published average", "Paper's filter", "True")  # fmt: skip
    note = (
        "Converged: from when on the averaged curve, or the mean absolute error of single runs, "
        "stays within a tenth of the initial error; not available where that is not before the "
        "last image. Average: of the curve over the whole first "
        "stage, the way from the initial value included; the paper does not say whether its own "
        "averages include it."
    )
    return Table("Convergence", header, tuple(rows), note)


def mean_square_table(document: Document) -> Table:
    """Figure 9 at the times that the paper tells."""
    group, paper = section(document, "mean_square"), section(document, "paper", "mean_square")
    t_s, runs = numbers(group.get("t_s")), number(section(document, "paper").get("runs"))
    of_filters = {name: section(group, "filters", name) for name in (PAPER, OURS)}
    bound = section(group, "bound")
    rows = []
    for time, published in zip(numbers(paper.get("t_s")), numbers(paper.get("px2")), strict=False):
        least = _nearest(t_s, bound, "optical", time)
        rows.append(
            (
                f"{time:.0f} s",
                significant(published, 2),
                *(significant(_nearest(t_s, of_filters[PAPER], key, time), 2)
                  for key in ("averaged", "optical")),
                significant(_nearest(t_s, of_filters[OURS], "optical", time), 2),
                significant(least, 2),
                significant(quotient(least, runs), 2),
                significant(_nearest(t_s, of_filters[PAPER], "image", time), 2),
            )
        )  # fmt: skip
    header = ("After", "Published", "Averaged curve", "Single runs", "SQRF", "Bound",
              "Bound of average", "On the detector")  # fmt: skip
    note = (
        "Mean of the squared errors of x0, y0 and f (in pixels) [px²]; the paper does not say what "
        "its mean is over. On the detector: of the star images per axis, single runs of the "
        "paper's filter, what a turn of the sensor explains taken out."
    )
    return Table("Mean square error at the times that the paper names", header, tuple(rows), note)


def _nearest(t_s: np.ndarray, group: Document, key: str, time: float) -> float | None:
    """Return a curve's value at the shown time nearest to another."""
    values = numbers(group.get(key))
    if len(values) != len(t_s) or not np.isfinite(t_s).any() or not np.isfinite(time):
        return None
    return number(float(values[int(np.nanargmin(np.abs(t_s - time)))]))


def spot_table(document: Document) -> Table:
    """Table 4: the star vector of one centroid."""
    group = section(document, "spot")
    labels = {"true": "Correct", "initial": "Uncalibrated", "fitted": "Calibrated, first run"}
    rows = []
    for key, label in labels.items():
        vector = numbers(section(group, "vectors").get(key))
        cells = [fixed(v, 6) for v in vector.tolist()] if len(vector) == 3 else [NOT_AVAILABLE] * 3
        rows.append((label, *cells, fixed(section(group, "rms_arcsec").get(key), 0)))
    place = f"({fixed(group.get('row_px'))}, {fixed(group.get('col_px'))})"
    note = (
        "Angle: to the correct vector, of the calibrated camera RMS over all runs (paper's "
        "filter). Most of it is the principal point, and common to all stars: the attitude or the "
        "mounting takes it up. The numbers of the paper's Table 4 are not in its text."
    )
    header = ("Star vector", "x", "y", "z", "Angle [arcsec]")
    return Table(f"Table 4. Star vector of the spot {place}", header, tuple(rows), note)


def noise_table(document: Document) -> Table:
    """Figure 11: RMS errors by noise level."""
    rows = [
        (f"{significant(level.get('noise_px'), 2)} px, {SHORT[name]}", *_row(level, name, "rms"))
        for level in sections(document.get("noise_levels"))
        for name in (PAPER, OURS)
    ]
    header = ("RMS error after 300 s", *(unit_of(name).label for name in NAMES))
    return Table("Figure 11. Errors by noise", header, tuple(rows))


def low_frequency_table(document: Document) -> Table:
    """Errors with low-frequency noise beside those without."""
    found = sections(document.get("low_frequency"))
    cases = [("white noise alone", section(document, "errors"))]
    cases += [(_case(case), case) for case in found]
    rows: list[tuple[str, ...]] = []
    for label, case in cases:
        rows.append((f"{label}: RMS", *_row(case, OURS, "rms")))
        told = section(case, "filters", OURS, "consistency")
        rows.append((f"{label}: RMS / own sd", *(fixed(told.get(name)) for name in NAMES)))
    header = ("SQRF, arclengths, after 300 s", *(unit_of(name).label for name in NAMES))
    noise = section(found[0], "noise") if found else {}
    note = (
        "First-order Gauss-Markov processes beside the white noise, with a time constant of "
        f"{fixed(noise.get('time_constant_s'), 0, 's')}: a displacement of the whole image, and a "
        "distortion that is quadratic in the place (sd per axis, RMS over the detector). The "
        "filters know of the white noise alone."
    )
    return Table("Noise of low frequency", header, tuple(rows), note)


def _case(case: Document) -> str:
    noise, name = section(case, "noise"), case.get("case")
    sizes = [noise.get(key) for key in ("common", "field") if number(noise.get(key))]
    told = ", ".join(f"{significant(size, 2)} px" for size in sizes)
    return f"{_CASES.get(str(name), NOT_AVAILABLE)} ({told})"


def _row(group: Document, name: str, key: str) -> list[str]:
    found = section(group, "filters", name, key)
    return [value_of(found, n) for n in NAMES]
