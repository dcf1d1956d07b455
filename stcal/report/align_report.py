"""The report of an alignment, for a browser and for a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stcal.report import align_content, align_figures, content
from stcal.report.document import Document
from stcal.report.layout import Part, Picture, heading, report_page
from stcal.report.terminal import print_table, print_verdict

if TYPE_CHECKING:
    from rich.console import Console

_CAPTION = (
    "Departure of each estimate from the method's last one, over the time since the first frame. "
    "Dotted: three sd. The linear filter's gain takes the stars of a frame as independent and the "
    "noise as equal in all directions."
)


def render_alignment(document: Document) -> str:
    """Return the HTML report of an alignment (schema ``stcal.alignment/1``)."""
    picture = align_figures.convergence(document, "align-convergence")
    part = Part(
        "Alignment",
        (
            align_content.method_table(document),
            Picture("Convergence", _CAPTION, (picture,)),
            align_content.result_table(document),
            align_content.agreement_table(document),
            align_content.alignment_facts(document),
            content.provenance_table(document),
        ),
    )
    return report_page(heading("Alignment", document), [_verdict(document)], [part])


def alignment_tables(document: Document, console: Console) -> None:
    """Print an alignment: verdict, methods, result, agreement."""
    print_verdict(_verdict(document), document, console)
    for build in (
        align_content.method_table,
        align_content.result_table,
        align_content.agreement_table,
    ):
        print_table(build(document), console)


def _verdict(document: Document) -> content.Verdict:
    return content.verdict(document, "Alignment")
