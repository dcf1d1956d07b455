"""The report of the study ``wu``, for a browser and for a terminal: findings first."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stcal.report import wu_comparison_content as beyond
from stcal.report import wu_content as content
from stcal.report import wu_figures as figures
from stcal.report.document import Document
from stcal.report.layout import Part, Picture
from stcal.report.study_content import finding_table
from stcal.report.study_page import study_page
from stcal.report.terminal import only_columns, print_table

if TYPE_CHECKING:
    from rich.console import Console

_HEADING = "Wu et al. 2019, repeated on simulated images"
_LEAD = (
    "The paper calibrates a star sensor in orbit by the singular values of star groups (SVD) in "
    "place of angular distances (AD). Its simulation is repeated here many times: 1920 × 1080 "
    "pixels, 16 mm, 0.5 px of noise, 2400 images of varying sky from initial values 3 % off in "
    "focal length. Both methods run in the same square-root filter on the same images, the stars "
    "being given, each weighted with its full covariance. Beside stands constant R, one variance "
    "for all values: the simplest reading of the paper, which doesn't give its R.",
    "In the tables the paper's values stand above ours. Verdicts are computed from the numbers of "
    "this run.",
)
_STATEMENTS = "statements, five of this study and ten of the paper"
# What 80 columns hold of the comparison with the bound.
_TERMINAL_BOUND = ("Group", 'Bound ["]', "AD / efficient", "SVD / efficient")


def render(document: Document) -> str:
    """Return the HTML report of the study (schema ``stcal.study.wu/1``)."""
    return study_page(
        document,
        _HEADING,
        _LEAD,
        [_comparison(document), _tables(document), _figures(document), _basis(document)],
        claims=_STATEMENTS,
    )


def study_tables(document: Document, console: Console) -> None:
    """Print the study on a terminal: Table 4, the bound, who wins, and the findings."""
    for table in (
        content.group_table(document),
        only_columns(beyond.bound_table(document), _TERMINAL_BOUND),
        beyond.win_table(document),
        finding_table(document, "Statement"),
    ):
        print_table(table, console)


def _comparison(document: Document) -> Part:
    return Part(
        "Angular distances or singular values",
        (
            beyond.win_table(document),
            beyond.bound_table(document),
            beyond.published_table(document),
        ),
    )


def _tables(document: Document) -> Part:
    return Part(
        "Tables",
        (
            content.model_table(document),
            content.value_table(document),
            content.group_table(document),
        ),
    )


def _figures(document: Document) -> Part:
    return Part(
        "Figures",
        (
            Picture(
                "Figures 3 and 4. Observability",
                "Smallest singular value of each image's Jacobian, scaled by Table 1's precision "
                "(eqs 30 to 33), unweighted, at the true camera; first images of the first run, "
                "group 2, stars in order of brightness. Model 3 has two groups of stars in an "
                "image: four values, which cannot determine six parameters; the squares of a "
                "group's three values add up to its number of stars.",
                (figures.observability(document, "wu-observability"),),
            ),
            Picture(
                "Figure 6. Convergence, group 2",
                "Root mean square error of an image's pairs with the estimate after that image, "
                "root mean square over the runs. Bound: what the centroids so far and the prior "
                "allow. Where the curves coincide, that of SVD hides that of AD.",
                (figures.convergence(document, "wu-convergence"),),
            ),
        ),
    )


def _basis(document: Document) -> Part:
    return Part("Basis", (beyond.settings_table(document),))
