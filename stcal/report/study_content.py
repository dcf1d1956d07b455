"""What the reports of all studies share: the findings."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from stcal.report.content import Table
from stcal.report.document import Document, sections
from stcal.report.format import words

# The verdicts of stcal.studies.findings, and the class of each on the page.
GRADES = {"holds": "good", "partly": "fair", "does not hold": "bad", "not tested": "open"}


@dataclass(frozen=True)
class Finding:
    """A published finding as the page shows it."""

    title: str
    section: str
    paper: str
    here: str
    why: str
    verdict: str

    @property
    def grade(self) -> str:
        """The verdict's class on the page."""
        return GRADES.get(self.verdict, "open")


def findings(document: Document) -> list[Finding]:
    """Return the document's findings."""
    keys = ("title", "section", "paper", "here", "why", "verdict")
    return [
        Finding(**{key: words(item.get(key)) for key in keys})
        for item in sections(document.get("findings"))
    ]


def summary(found: list[Finding], claims: str = "findings of the paper") -> str:
    """Return how many findings got which verdict: ``Of 9 findings of the paper, 7 hold, ...``."""
    count = Counter(finding.verdict for finding in found)
    phrases = {
        "holds": ("holds", "hold"),
        "partly": ("holds in part", "hold in part"),
        "does not hold": ("does not hold", "do not hold"),
        "not tested": ("could not be tested", "could not be tested"),
    }
    parts = [
        f"{count[verdict]} {one if count[verdict] == 1 else more}"
        for verdict, (one, more) in phrases.items()
        if count[verdict]
    ]
    return f"Of {len(found)} {claims}, {', '.join(parts) or 'none is known'}."


def finding_table(document: Document, claim: str = "Finding of the paper") -> Table:
    """The findings as a table, for the terminal."""
    rows = tuple(
        (str(place), finding.title, finding.verdict, finding.here)
        for place, finding in enumerate(findings(document), 1)
    )
    header = ("", claim, "Verdict", "Here")
    return Table("Findings", header, rows, numeric=False)
