"""The page of a study: findings first, then its parts."""

from __future__ import annotations

from collections.abc import Sequence

from stcal.report.document import Document
from stcal.report.layout import Part, page
from stcal.report.study_content import findings, summary


def study_page(
    document: Document,
    heading: str,
    lead: Sequence[str],
    parts: Sequence[Part],
    claim: str = "Paper",
    claims: str = "findings of the paper",
) -> str:
    """Return the HTML page of a study.

    Parameters
    ----------
    claim : the word beside what each finding says was to be expected
    claims : what the findings are, in the sentence that counts them
    """
    found = findings(document)
    return page(
        "study.html.j2",
        heading=heading,
        lead=lead,
        summary=summary(found, claims),
        findings=found,
        claim=claim,
        parts=parts,
    )
