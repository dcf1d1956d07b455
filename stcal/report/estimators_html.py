"""The report of the study ``estimators``, for a browser and for a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stcal.report import estimators_content as content
from stcal.report import estimators_figures as figures
from stcal.report.document import Document
from stcal.report.layout import Part, Picture
from stcal.report.study_content import finding_table
from stcal.report.study_page import study_page
from stcal.report.terminal import print_table

if TYPE_CHECKING:
    from rich.console import Console

HEADING = "Which estimator should I use?"
ACCURACY_CAPTION = (
    "Rms error of directions over the bound, against time of a thread per frame. Colours are "
    "residuals, markers estimators; dotted: the efficient estimate on the same frames."
)
ROBUSTNESS_CAPTION = "Runs that end well, in percent, by combination and condition."


def render(document: Document) -> str:
    """Return the HTML report of the study (schema ``stcal.study.estimators/1``)."""
    return study_page(
        document,
        HEADING,
        tuple(content.answer(document)),
        [_decision(document), _plots(document), _whole(document)],
        claim="Expected",
        claims="expectations",
    )


def study_tables(document: Document, console: Console) -> None:
    """Print the study on a terminal: the answer, the figures that decide, the findings."""
    from rich.text import Text

    for sentence in content.answer(document):
        console.print(Text(sentence))
    print_table(content.summary_table(document), console)
    print_table(finding_table(document, "Expectation"), console)


def _decision(document: Document) -> Part:
    return Part("Decision", (content.summary_table(document),))


def _plots(document: Document) -> Part:
    return Part(
        "Plots",
        (
            Picture(
                "Accuracy and time",
                ACCURACY_CAPTION,
                (figures.accuracy_and_time(document, "estimators-accuracy"),),
            ),
            Picture(
                "Robustness",
                ROBUSTNESS_CAPTION,
                (figures.robustness(document, "estimators-robustness"),),
            ),
        ),
    )


def _whole(document: Document) -> Part:
    return Part("Results", (content.whole_table(document), content.settings_table(document)))
