"""The report of the study ``zhang``, for a browser and for a terminal: findings first."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stcal.report import zhang_content as content
from stcal.report import zhang_figures as figures
from stcal.report import zhang_mounting_content as mounting
from stcal.report.document import Document
from stcal.report.layout import Part, Picture
from stcal.report.study_content import finding_table
from stcal.report.study_page import study_page
from stcal.report.terminal import only_columns, print_table

if TYPE_CHECKING:
    from rich.console import Console

_HEADING = "Zhang, Dong & Zhao 2024, repeated on simulated images"
_LEAD = (
    "The paper calibrates a star sensor in a low orbit in two stages: an unscented filter on the "
    "inner products of star pairs estimates principal point, focal length and radial distortion; a "
    "linear filter on the nine elements of a matrix then estimates how the sensor sits in the "
    "body. Both are repeated here with the paper's noise, beside other filters on the same "
    "centroids and the Cramer-Rao bound. The identities of the stars are given.",
    "The paper's Tables 1 to 5 are not in its text. Orbit, stars, images per second and initial "
    "values are this study's choice, named under Basis: published errors compare in their size "
    "only. Verdicts are computed from the numbers of this run.",
)
# What 80 columns hold of the mountings.
_TERMINAL_COLUMNS = 5


def render(document: Document) -> str:
    """Return the HTML report of the study (schema ``stcal.study.zhang/1``)."""
    return study_page(
        document,
        _HEADING,
        _LEAD,
        [_first_stage(document), _noise(document), _second_stage(document), _basis(document)],
    )


def study_tables(document: Document, console: Console) -> None:
    """Print the study on a terminal: errors of the two stages, and the findings."""
    mountings = mounting.mounting_table(document)
    for table in (
        content.error_table(document),
        only_columns(mountings, mountings.header[:_TERMINAL_COLUMNS]),
        finding_table(document),
    ):
        print_table(table, console)


def _first_stage(document: Document) -> Part:
    return Part(
        "First stage: the camera",
        (
            content.error_table(document),
            content.filter_table(document),
            Picture(
                "Figures 7 and 8. Convergence of the five parameters",
                "RMS error of single runs, the filter's own sd of it, and the error of the "
                "averaged curve. The paper's filter has a larger error than the bound and a "
                "smaller sd than its error. The averaged curve is not what one sensor has.",
                (figures.convergence(document, "zhang-convergence"),),
            ),
            content.convergence_table(document),
            Picture(
                "Figure 9. Mean square error",
                "Of principal point and focal length, in pixels.",
                (figures.mean_square(document, "zhang-square"),),
            ),
            content.mean_square_table(document),
            _distortion(document),
            content.spot_table(document),
        ),
    )


def _distortion(document: Document) -> Picture:
    kinds = (
        (content.PAPER, "distortion", "zhang-map-k"),
        (content.OURS, "distortion", "zhang-map-ours-k"),
        (content.PAPER, "image", "zhang-map"),
        (content.OURS, "image", "zhang-map-ours"),
    )
    return Picture(
        "Figure 10. Displacement of stars by the errors that are left",
        "RMS over the runs after 500 s. Above: by the errors of k1 and k2 alone, as the paper "
        "shows it. Below: by those of all parameters, a turn of the sensor taken out.",
        tuple(figures.residual_distortion(document, *kind) for kind in kinds),
    )


def _noise(document: Document) -> Part:
    return Part(
        "Noise",
        (
            Picture(
                "Figure 11. Errors by noise",
                "RMS over the runs after 300 s; every level has the same draws, scaled.",
                (figures.noise_levels(document, "zhang-noise"),),
            ),
            content.noise_table(document),
            content.low_frequency_table(document),
        ),
    )


def _second_stage(document: Document) -> Part:
    return Part(
        "Second stage: the mounting",
        (
            mounting.mounting_table(document),
            Picture(
                "Figure 12. Errors of the mounting",
                "Linear filter, made a rotation, with the star vectors of three cameras. With a "
                "fitted camera the error is that camera's from the first image on.",
                (figures.mounting(document, "zhang-mounting"),),
            ),
            mounting.matrix_table(document),
        ),
    )


def _basis(document: Document) -> Part:
    return Part("Basis", (mounting.parameter_table(document), mounting.settings_table(document)))
