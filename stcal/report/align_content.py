"""What the report of an alignment says, as tables of text."""

from __future__ import annotations

from stcal.report.content import (
    Table,
    matrix_rows,
    origin,
)
from stcal.report.document import Document, numbers, section, text
from stcal.report.format import (
    count,
    fixed,
    interval,
    measured,
    significant,
    vector,
    words,
)

_ANGLES = ("roll", "pitch", "yaw")
_BY_AXIS = (
    ("sd about", "sd_arcsec"),
    ("From multiplicative, about", "from_multiplicative_arcsec"),
)


def method_table(document: Document) -> Table:
    """Every method's angles with sd, and how far it is from the multiplicative one."""
    methods = section(document, "methods")
    found = [section(methods, name) for name in methods]
    rows = [
        (f"{angle.capitalize()} [deg]", *(_angle(m, angle) for m in found)) for angle in _ANGLES
    ]
    for label, key in _BY_AXIS:
        rows += [
            (f"{label} {axis} of S [arcsec]", *(_item(m, key, k) for m in found))
            for k, axis in enumerate("xyz")
        ]
    note = (
        "Roll, pitch, yaw: the sequence 3-2-1 that turns the axes of B into those of S. The sd is "
        "of the small rotation error about the axes of S."
    )
    header = ("", *(text(name).capitalize() for name in methods))
    title = "Mounting of the sensor by each method"
    return Table(title, header, tuple(rows) if found else (), note)


def result_table(document: Document) -> Table:
    """The result as a matrix and a quaternion; not available when refused."""
    result = section(document, "result")
    rows = matrix_rows("C_SB", result.get("c_sb"))
    rows.append(("Quaternion of S relative to B", vector(result.get("q_sb"), 9)))
    note = "C_SB takes components in the body frame B to the sensor frame S."
    return Table("Result", ("", ""), tuple(rows), note, numeric=False)


def agreement_table(document: Document) -> Table:
    """How many frames and stars were used, and how well they agree."""
    nis, noise = section(document, "nis"), section(document, "noise")
    scatter = vector(noise.get("frames"), 2, signed=False)
    rows = (
        ("Frames", count(document.get("frames"))),
        ("Frames identified", count(document.get("frames_identified"))),
        ("Frames with a body attitude", count(document.get("frames_with_attitude"))),
        ("Frames used", count(document.get("frames_used"))),
        ("Frames left out as outliers", count(document.get("frames_rejected"))),
        ("Stars used", count(document.get("stars_used"))),
        ("Stars left out as outliers", count(document.get("stars_rejected"))),
        ("Residual RMS", fixed(document.get("rms_residual_urad"), 1, "µrad")),
        ("NIS per frame, mean", significant(nis.get("mean"), 3)),
        ("NIS per frame, expected", f"{significant(nis.get('expected'), 3)} "
         f"({interval(nis.get('interval'), 2)})"),
        ("Stars' scatter / noise", fixed(noise.get("stars"), 2)),
        ("Frames' scatter / noise, x y z", scatter),
        ("sd raised for correlation by, x y z", vector(noise.get("correlation"), 2, signed=False)),
        ("Attitude noise beside the stated", fixed(noise.get("attitude_excess_urad"), 1, "µrad")),
    )  # fmt: skip
    return Table("Agreement of the frames", ("", ""), rows, numeric=False)


def alignment_facts(document: Document) -> Table:
    """What was aligned against what."""
    span, body = section(document, "span"), section(document, "body")
    rows = [
        ("Sensor", words(document.get("sensor_id"))),
        ("Calibration serial", words(document.get("calibration_serial"))),
        ("Method", words(document.get("method"))),
        ("Time span", f"{words(span.get('from'))} to {words(span.get('to'))}"),
    ]
    rows += [(f"Body: {text(key).replace('_', ' ')}", words(body.get(key))) for key in body]
    return Table("The alignment", ("", ""), (*rows, *origin(document)), numeric=False)


def _angle(method: Document, name: str) -> str:
    """An angle with the decimals that the largest sd justifies."""
    sd = numbers(method.get("sd_arcsec"))
    spread_deg = float(sd.max()) / 3600.0 if len(sd) else None
    return measured(section(method, "angles_deg").get(name), spread_deg)


def _item(method: Document, key: str, index: int) -> str:
    values = numbers(method.get(key))
    return fixed(float(values[index]) if len(values) == 3 else None, 2)
