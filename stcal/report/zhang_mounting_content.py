"""What the report of the study ``zhang`` says of the second stage, and of the study itself."""

from __future__ import annotations

from stcal.report.content import Table, origin
from stcal.report.document import Document, matrix, number, section
from stcal.report.format import NOT_AVAILABLE, count, fixed, significant, vector, words
from stcal.report.zhang_content import FILTERS, NAMES, OURS, PAPER, value_of
from stcal.units import unit_of

# Whose star vectors the second stage takes: the filter of the first stage.
CAMERAS = {PAPER: "Paper's", OURS: "SQRF", "true": "True"}
METHODS = ("nine elements", "linear", "multiplicative")
_TIMES = {"element": 1e5, "diagonal": 1e6}


def mounting_table(document: Document) -> Table:
    """Errors of the mounting after 200 s, by camera and method."""
    found, paper = section(document, "alignment"), section(document, "paper")
    printed = section(paper, "printed")
    rows = [
        ("Published", *_errors(section(paper, "alignment")), *[""] * 5),
        ("Printed matrices", *_errors(printed)[:2], *[""] * 6),
    ]
    for camera, label in CAMERAS.items():
        for method in METHODS:
            read = section(found, "cameras", camera, method, "read")
            cells = [fixed(read.get("averaged_angle_deg"), 5)]
            cells += [_known(read.get(key), 5) for key in ("own_sd_deg", "sd_deg")]
            cells += [_known(read.get(key), 2) for key in ("own_consistency", "consistency")]
            rows.append((f"{label}, {method}", *_errors(read), *cells))
    header = (f"Camera and method, after {fixed(found.get('read_s'), 0, 's')}", "Element [10⁻⁵]",
              "Diagonal [10⁻⁶]", "Angle [deg]", "Angle, averaged [deg]", "Own sd [deg]",
              "sd with camera [deg]", "RMS / own sd", "RMS / sd with camera")  # fmt: skip
    title = "Table 5. Errors of the mounting"
    return Table(title, header, tuple(rows), _mounting_note(document))


def _errors(group: Document) -> list[str]:
    cells = [significant(_times(group.get(key), factor), 2) for key, factor in _TIMES.items()]
    return [*cells, fixed(group.get("angle_deg"), 5)]


def _times(value: object, factor: float) -> float | None:
    found = number(value)
    return None if found is None else factor * found


def _known(value: object, decimals: int) -> str:
    """One cell; the nine elements have no sd of a rotation."""
    return "" if value is None else fixed(value, decimals)


def _mounting_note(document: Document) -> str:
    noise = fixed(section(document, "alignment").get("attitude_sd_urad"), 0, "µrad")
    turns = vector(section(document, "paper", "printed").get("angles_deg"), 4, "deg")
    return (
        "Camera: that which the paper's filter or the square-root filter has fitted, or the true "
        "one. Mean absolute errors over elements or angles and over the runs; averaged: of the "
        "matrices averaged over the runs. Nine elements: as the paper's filter has them; linear: "
        "made a rotation; multiplicative: three small angles. The other sensor's attitude has "
        f"a noise of {noise} per axis and image, which the paper does not give. The sd with "
        "camera adds what the covariance of the first stage makes of the mounting; the second "
        "stage's own knows nothing of it. Made rotations, the printed matrices (52) and (53) "
        "differ by "
        f"{turns} about x, y, z."
    )


def matrix_table(document: Document) -> Table:
    """Eqs (52) and (53) with ours beside."""
    found = section(document, "alignment")
    columns = (
        ("True, a rotation", found.get("c_sb")),
        ("Published (53)", section(document, "paper").get("matrix")),
        ("Here, first run", section(found, "matrix").get("single")),
        ("Here, averaged", section(found, "matrix").get("averaged")),
    )
    rows = []
    for k, axis in enumerate("xyz"):
        lines = [matrix(value, 3) for _, value in columns]
        cells = (
            NOT_AVAILABLE if m is None or len(m) != 3 else vector(m[k].tolist(), 5, signed=False)
            for m in lines
        )
        rows.append((axis, *cells))
    header = ("Row", *(title for title, _ in columns))
    note = "Of the nine elements, with the camera of the paper's filter."
    return Table("The mounting matrix", header, tuple(rows), note)


def parameter_table(document: Document) -> Table:
    """True and initial values, and what the filters know before."""
    groups = section(document, "settings", "parameters")
    keys = {"true": "True", "initial": "Initial", "prior_sd": "sd before"}
    rows = [
        (unit_of(name).label, *(value_of(section(groups, key), name, 6) for key in keys))
        for name in NAMES
    ]
    note = (
        "True: where the published averages lie. Initial: the principal point at the detector's "
        "middle, focal length and distortion as from a poor ground calibration."
    )
    return Table("Parameters", ("", *keys.values()), tuple(rows), note)


def settings_table(document: Document) -> Table:
    """What the numbers depend on."""
    settings = section(document, "settings")
    stars = section(settings, "stars_per_image")
    size = fixed(_times(settings.get("pixel_size_m"), 1e6), 1, "µm")
    range_of = f"{count(stars.get('least'))} to {count(stars.get('most'))}"
    rows = (
        ("Runs", count(document.get("runs"))),
        ("Seed of the noise", count(document.get("seed"))),
        ("Filters", "; ".join(FILTERS.values())),
        ("Orbit", f"circular, {fixed(settings.get('altitude_km'), 0, 'km')}, inclination "
         f"{fixed(settings.get('inclination_deg'), 1, 'deg')}"),
        ("Attitude", "body in the orbital frame, z to the zenith; sensor by matrix (52)"),
        ("Detector", f"{count(settings.get('rows'))} × {count(settings.get('cols'))} px of {size}"),
        ("Limiting magnitude", fixed(settings.get("limiting_magnitude"), 1)),
        ("Stars in an image", f"{fixed(stars.get('mean'), 1)} ({range_of})"),
        ("Images per second", fixed(settings.get("images_per_s"), 1)),
        ("Images, first stage", count(settings.get("calibration_images"))),
        ("Images, second stage", count(settings.get("alignment_images"))),
        ("Sensor", words(document.get("sensor_id"))),
        *origin(document),
    )  # fmt: skip
    return Table("The study", ("", ""), rows, numeric=False)
