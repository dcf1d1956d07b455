"""The HTML report of an upload: what it holds and which gates it passed."""

from __future__ import annotations

from stcal.report import upload_content as content
from stcal.report.document import Document
from stcal.report.layout import Part, heading, report_page


def render(document: Document) -> str:
    """Return the HTML report of an upload's manifest (schema ``stcal.upload/1``)."""
    part = Part(
        "Upload",
        (
            content.upload_facts(document),
            content.gate_table(document),
            content.field_table(document),
            content.file_table(document),
            content.figure_table(document),
        ),
    )
    return report_page(heading("Upload", document), [content.upload_verdict(document)], [part])
