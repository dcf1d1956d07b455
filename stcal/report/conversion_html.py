"""The HTML report of a conversion between camera models."""

from __future__ import annotations

from stcal.report import content, conversion_content, conversion_figures
from stcal.report.document import Document, section
from stcal.report.layout import Part, Picture, heading, report_page


def render(document: Document) -> str:
    """Return the HTML report of a conversion (schema ``stcal.conversion/1``)."""
    verdict = content.verdict(document, "Conversion")
    return report_page(heading("Conversion", document), [verdict], [_conversion_part(document)])


def _conversion_part(document: Document) -> Part:
    field = section(document, "field")
    return Part(
        "Conversion",
        (
            conversion_content.error_table(document),
            Picture(
                "Error over the detector",
                "Angle between the directions in which the old and the new camera see a centroid, "
                "the turn of D removed. Arrows: where the new camera sees the old direction, minus "
                "the centroid, looking out along the boresight.",
                (conversion_figures.error_map(field, "conversion-error"),),
            ),
            conversion_content.parameter_table(document, "old"),
            conversion_content.parameter_table(document, "new"),
            conversion_content.source_table(document),
        ),
    )
