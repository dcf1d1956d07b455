"""One self-contained HTML file per fit, validation, both of them, or study: verdict first.

Everything that comes from a document is escaped; the figures are inline SVG; nothing is loaded
from outside and no script is needed.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from stcal.atomic import write_text
from stcal.errors import InputError
from stcal.report import (
    align_report,
    content,
    conversion_html,
    enright_html,
    estimators_html,
    figures,
    filter_figures,
    fit_content,
    fit_figures,
    fleet_html,
    tracking_html,
    wu_html,
    zhang_html,
)
from stcal.report.content import Table, Verdict
from stcal.report.document import (
    ALIGNMENT_SCHEMA,
    CONVERSION_SCHEMA,
    ENRIGHT_SCHEMA,
    ESTIMATORS_SCHEMA,
    FIT_SCHEMA,
    FLEET_SCHEMA,
    TRACKING_SCHEMA,
    VALIDATION_SCHEMA,
    WU_SCHEMA,
    ZHANG_SCHEMA,
    Document,
    numbers,
    section,
    text,
)
from stcal.report.filter_content import filter_tables, is_sequential
from stcal.report.layout import Part, Picture, heading, report_page


def render_fit(document: Document) -> str:
    """Return the HTML report of a fit (schema ``stcal.fit/1``)."""
    return report_page(
        heading("Recalibration", document), [_fit_verdict(document)], [_fit_part(document)]
    )


def render_validation(document: Document) -> str:
    """Return the HTML report of a validation (schema ``stcal.validation/1``)."""
    verdicts, parts = [_validation_verdict(document)], [_validation_part(document)]
    return report_page(heading("Validation", document), verdicts, parts)


def render_recalibration(
    fit: Document,
    validation: Document,
    files: tuple[object, object] = ("the fit", "the validation"),
) -> str:
    """Return one HTML report of a fit and of its validation, both verdicts first.

    ``files`` names the two in messages.

    Raises
    ------
    InputError
        When the two belong to different sensors.
    """
    names = [text(document.get("sensor_id")) for document in (fit, validation)]
    if names[0] != names[1]:
        raise InputError(f"{files[0]} is of sensor {names[0]!r}, {files[1]} of sensor {names[1]!r}")
    verdicts = [_validation_verdict(validation), _fit_verdict(fit)]
    parts = [_validation_part(validation), _fit_part(fit)]
    return report_page(heading("Recalibration and validation", fit), verdicts, parts)


RENDERERS: dict[str, Callable[[Document], str]] = {
    FIT_SCHEMA: render_fit,
    VALIDATION_SCHEMA: render_validation,
    ALIGNMENT_SCHEMA: align_report.render_alignment,
    CONVERSION_SCHEMA: conversion_html.render,
    ENRIGHT_SCHEMA: enright_html.render,
    ESTIMATORS_SCHEMA: estimators_html.render,
    FLEET_SCHEMA: fleet_html.render,
    TRACKING_SCHEMA: tracking_html.render,
    WU_SCHEMA: wu_html.render,
    ZHANG_SCHEMA: zhang_html.render,
}


def write_report(document: Document, path: Path) -> None:
    """Write the HTML report of a document, by its schema.

    Raises
    ------
    InputError
        When no report is known for the schema.
    """
    renderer = RENDERERS.get(str(document.get("schema")))
    if renderer is None:
        raise InputError(f"no report for schema {document.get('schema')!r}")
    write_text(path, renderer(document))


def write_recalibration(
    fit: Document,
    validation: Document,
    path: Path,
    files: tuple[object, object] = ("the fit", "the validation"),
) -> None:
    """Write the HTML report of a fit and its validation (read from ``files``) in one file."""
    write_text(path, render_recalibration(fit, validation, files))


def _fit_verdict(document: Document) -> Verdict:
    return content.verdict(document, "Fit")


def _validation_verdict(document: Document) -> Verdict:
    return content.verdict(document, "Validation")


def _fit_part(document: Document) -> Part:
    labels = ("initial", "fitted")
    return Part(
        "Fit",
        (
            fit_content.fit_summary(document),
            *_detector_pictures(document, labels, "fit"),
            fit_content.parameter_table(document),
            Picture(
                "Parameter changes",
                "Bars: change from the initial calibration over sigma, the parameter's spread "
                "from unit to unit. Whiskers: the fit's sd on the same scale.",
                (fit_figures.parameter_changes(document, "fit-changes"),),
            ),
            fit_content.observability_table(document),
            Picture(
                "",
                "Left: correlation of the fitted parameters. Right: singular values of the "
                "scaled problem; each line is named by the two largest components of its "
                "direction. The smallest value is what the data show least.",
                (
                    fit_figures.correlations(document, "fit-correlation"),
                    fit_figures.singular_values(document, "fit-singular"),
                ),
            ),
            _time_picture(document, labels, "fit"),
            *_way_items(document),
            fit_content.c_sd_table(document),
            fit_content.fit_facts(document),
            content.provenance_table(document),
        ),
    )


def _way_items(document: Document) -> tuple[Table | Picture, ...]:
    """How the fit came about: a filter's way through the frames, or a batch fit's cycles."""
    if not is_sequential(document):
        cycles = fit_figures.cycles(document, "fit-cycles")
        return fit_content.cycle_table(document), Picture("", "", (cycles,))
    return (
        *filter_tables(document),
        Picture(
            "Convergence",
            "Each parameter's departure from its last value, in units of its sd at the end (given "
            "above each panel). Grey: within 3 sd as the filter knew it at that frame; a parameter "
            "with process noise may leave it by moving. The scale is linear within 3 sd and "
            "logarithmic beyond; frames are spaced by their root.",
            (filter_figures.convergence(document, "fit-convergence"),),
        ),
        Picture(
            "Innovations and matched stars",
            "Above: normalised innovation squared (NIS) of each frame per arclength; triangles lie "
            "above the range. Grey: where 95 % of the frames should lie, for a typical number of "
            "arcs. Below: matched stars, both exposures together, each frame identified with the "
            "estimate before it.",
            (filter_figures.way_of_filter(document, "fit-way"),),
        ),
    )


def _validation_part(document: Document) -> Part:
    labels = ("baseline", "candidate")
    return Part(
        "Validation",
        (
            content.validation_summary(document),
            *_detector_pictures(document, labels, "validation"),
            _time_picture(document, labels, "validation"),
            content.validation_facts(document),
            content.provenance_table(document),
        ),
    )


def _detector_pictures(
    document: Document, labels: tuple[str, str], prefix: str
) -> tuple[Picture, Picture]:
    field = section(document, "field")
    vectors = tuple(
        figures.residual_field(field, which, label, f"{prefix}-field-{which}")
        for which, label in zip(("before", "after"), labels, strict=True)
    )
    stars = float(np.nansum(numbers(field.get("count"))))
    basis = f"{stars:.0f} stars" if stars else "stars"
    return (
        Picture(
            "Residual field",
            f"Mean residual (measured minus predicted) in each detector cell, of {basis}, looking "
            "out along the boresight. Each picture has its own scale, given by the arrow above it. "
            "Grey: fewer than 5 stars.",
            vectors,
        ),
        Picture(
            "Radial profile",
            "Mean of the residual's radial component over rings around the detector's centre; a "
            "curve is distortion left in the model. Whiskers: one sd of the mean.",
            (figures.radial_profile(section(document, "radial"), labels, f"{prefix}-radial"),),
        ),
    )


def _time_picture(document: Document, labels: tuple[str, str], prefix: str) -> Picture:
    svg = figures.matched_over_time(section(document, "series"), labels, f"{prefix}-series")
    caption = (
        "Above: matched stars, both exposures together. Below: one tick for each frame without a "
        "fix, and their share."
    )
    return Picture("Matched stars and availability over time", caption, (svg,))
