"""The HTML report of the study ``enright``: findings first, then the paper's tables and figures."""

from __future__ import annotations

from stcal.report import enright_basis as basis
from stcal.report import enright_content as content
from stcal.report import enright_figures as figures
from stcal.report.document import Document
from stcal.report.enright_document import sensor_name, shown_sensor
from stcal.report.layout import Part, Picture
from stcal.report.study_page import study_page

_HEADING = "Enright, Jovanović & Vaz 2018, repeated on simulated sensors"
_LEAD = (
    "The paper recalibrates six ST-16 star trackers from orbital telemetry. Its telemetry is not "
    "public. Here six sensors are simulated with the orbits and motions of its Table I and, as the "
    "difference between initial and true camera, the parameter changes of its Table III; then every"
    " test of its section III is run. Noise is white, the camera model is exact, and nothing drifts"
    ": the comparison is one of behaviour, not of values.",
    "In the tables the paper's values stand above ours. Verdicts are computed from the numbers of "
    "this run.",
)


def render(document: Document) -> str:
    """Return the HTML report of the study (schema ``stcal.study.enright/1``)."""
    return study_page(
        document,
        _HEADING,
        _LEAD,
        [_tables(document), _figures(document), _basis(document)],
    )


def _tables(document: Document) -> Part:
    return Part(
        "Tables",
        (
            content.change_table(document),
            content.performance_table(document),
            content.error_table(document),
            content.matching_table(document),
            content.distortion_table(document),
        ),
    )


def _figures(document: Document) -> Part:
    return Part(
        "Figures",
        (
            _convergence(shown_sensor(document, "convergence")),
            _errors(shown_sensor(document, "errors")),
            _radial(shown_sensor(document, "radial")),
            _settling(shown_sensor(document, "settling")),
        ),
    )


def _convergence(sensor: Document) -> Picture:
    return Picture(
        f"Figure 3. Focal length convergence, {sensor_name(sensor)}",
        "Estimate after each frame minus the batch value (eq 31); dashed: its 3-sigma bounds. The "
        "first frames lie outside the range shown. Where curves coincide, the later one in the "
        "legend hides the others.",
        (figures.convergence(sensor, "enright-convergence"),),
    )


def _errors(sensor: Document) -> Picture:
    return Picture(
        f"Figure 4. Tail and aggregate errors, {sensor_name(sensor)}",
        "Filters started from the batch calibration. Tail (eq 32): all frames with the estimate "
        "after frame k. Aggregate (eq 33): each frame with its own estimate. The axis of frames is "
        "logarithmic; the first frames lie above the range shown.",
        (figures.errors(sensor, "enright-errors"),),
    )


def _radial(sensor: Document) -> Picture:
    return Picture(
        f"Figure 5. Radial differences from the batch camera, {sensor_name(sensor)}",
        "How much farther out than the batch camera each filter's camera sees the same centroid. "
        "Dotted: the true camera, which shows the batch fit's own error with opposite sign. The "
        "vertical line marks the paper's 800 pixels.",
        (figures.radial(sensor, "enright-radial"),),
    )


def _settling(sensor: Document) -> Picture:
    return Picture(
        f"Settling, {sensor_name(sensor)} (not in the paper)",
        "Availability and common-pair RMS on the validation data with the No-Q filter's estimate "
        "after so many calibration frames; 0 is the initial calibration.",
        (figures.settling(sensor, "enright-settling"),),
    )


def _basis(document: Document) -> Part:
    return Part("Basis", (basis.gate_table(document), basis.settings_table(document)))
