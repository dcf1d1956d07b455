"""The HTML report of the study ``tracking``: findings first, then drift, step and temperature."""

from __future__ import annotations

from stcal.report import tracking_content as content
from stcal.report import tracking_figures as figures
from stcal.report.document import Document
from stcal.report.layout import Part, Picture
from stcal.report.study_page import study_page

_HEADING = "Filters on cameras that change in flight"
_LEAD = (
    "A sequential filter may take the camera's parameters as constants (No-Q), let them walk at "
    "random (Q), or make them linear in the telemetered temperature. Here the truth is known: one "
    "simulated camera's focal length follows its temperature around each orbit, another's focal "
    "length and principal point jump at once, and a third stays as it is while its temperature "
    "swings.",
    "Shares, errors and verdicts are computed from the numbers of this run. Figures show its first "
    "seed.",
)

_ERRORS = (
    "Arclengths of each frame with the estimate before it, over the same star pairs for all; RMS "
    "over blocks of 25 frames."
)


def render(document: Document) -> str:
    """Return the HTML report of the study (schema ``stcal.study.tracking/1``)."""
    return study_page(
        document,
        _HEADING,
        _LEAD,
        [_drift(document), _step(document), _temperature(document), _basis(document)],
        claim="Expected",
        claims="expectations",
    )


def _drift(document: Document) -> Part:
    case = content.case_of(document, "drift")
    return Part(
        "Drift",
        (
            content.drift_table(document),
            Picture(
                "Focal length",
                "Change from the camera at the reference temperature. Dashed: truth. Shaded: "
                "within 3 sd of the estimate.",
                (figures.drift(case, "tracking-drift"),),
            ),
            Picture(
                "Errors by process noise",
                "Estimate minus truth; shaded: within 3 sd of the truth, where 99.7 % of the frames"
                " should lie.",
                (figures.drift_errors(case, "tracking-noise"),),
            ),
            Picture(
                "Principal point",
                "It does not move; without process noise it bends to explain the focal length's "
                "drift. Each panel has its own scale.",
                (figures.principal_point(case, "tracking-point"),),
            ),
            Picture(
                "Star errors",
                _ERRORS,
                (figures.errors(case, "tracking-drift-errors"),),
            ),
            content.parameter_table(document, "drift"),
        ),
    )


def _step(document: Document) -> Part:
    case = content.case_of(document, "step")
    return Part(
        "Step",
        (
            content.step_table(document),
            Picture(
                "Around the step",
                "Change from the camera before the step. Dashed: truth. Shaded: within 3 sd of the "
                "estimate.",
                (figures.step(case, "tracking-step"),),
            ),
            Picture(
                "Star errors",
                _ERRORS,
                (figures.errors(case, "tracking-step-errors"),),
            ),
            content.parameter_table(document, "step"),
        ),
    )


def _temperature(document: Document) -> Part:
    return Part("Temperature", (content.temperature_table(document),))


def _basis(document: Document) -> Part:
    return Part("Basis", (content.variant_table(document), content.settings_table(document)))
