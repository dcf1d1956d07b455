"""The documentation's page of the study ``estimators``: Markdown, and two plots beside it."""

from __future__ import annotations

import re
from pathlib import Path

from stcal.atomic import write_text
from stcal.report import estimators_content as content
from stcal.report import estimators_figures as figures
from stcal.report.content import Table
from stcal.report.document import Document, section
from stcal.report.estimators_html import ACCURACY_CAPTION, HEADING, ROBUSTNESS_CAPTION
from stcal.report.format import (
    count,
    share,
    significant,
    words,
)

PLOTS = {
    "accuracy": "Error over the bound against time per frame",
    "robustness": "Share of runs that end well",
}
_SPECIAL = re.compile(r"([\\`*_\[\]<>|#])")


def page(document: Document, stem: str, command: str) -> str:
    """Return the page as Markdown.

    Parameters
    ----------
    document : of schema ``stcal.study.estimators/1``
    stem : the plots are ``stem-accuracy.svg`` and ``stem-robustness.svg`` beside the page
    command : the command line that repeats it
    """
    captions = {"accuracy": ACCURACY_CAPTION, "robustness": ROBUSTNESS_CAPTION}
    plots = [f"![{PLOTS[kind]}]({stem}-{kind}.svg)\n\n{captions[kind]}" for kind in PLOTS]
    parts = [
        f"# {HEADING}",
        " ".join(map(_escaped, content.answer(document))),
        "## All combinations",
        table_text(content.whole_table(document)),
        "## Plots",
        *plots,
        "## How it was measured",
        *_measured(document),
        "## Repeat it",
        f"```\n{command}\n```",
        "This page is made by that command; don't edit it by hand.",
    ]
    return "\n\n".join(parts) + "\n"


def table_text(table: Table) -> str:
    """Return a table as Markdown, with its note."""
    lines = [_line(table.header), _line(["---"] * 3 + ["---:"] * (len(table.header) - 3))]
    lines += [_line([_escaped(cell) for cell in row]) for row in table.rows]
    return "\n".join(lines) + f"\n\n{_escaped(table.note)}"


def _line(cells: list[str] | tuple[str, ...]) -> str:
    return f"| {' | '.join(cells)} |"


def _escaped(value: str) -> str:
    """Return text with what Markdown would read as markup escaped."""
    return _SPECIAL.sub(r"\\\1", value)


def _measured(document: Document) -> list[str]:
    """Return how the figures came about."""
    robust = section(document, "robustness")
    starts = ", ".join(significant(v, 3) for v in content.conditions(document, "start_sigma"))
    shares = ", ".join(share(v) for v in content.conditions(document, "false_shares"))
    cameras = "\n".join(
        f"- {_escaped(name)}: {_escaped(facts)}." for name, facts in content.camera_rows(document)
    )
    return [
        f"Simulated telemetry, {count(document.get('runs'))} runs of "
        f"{count(document.get('frames'))} frames from each sensor, with the stars' true names "
        "given: all combinations get the same frames, so that only residual and estimator differ. "
        "They start from the camera on board; filters take parameters as constants (no process "
        "noise) under the configured prior.",
        cameras,
        "**Accuracy.** Rms angle between fitted and true directions over a grid on the detector, a "
        "common rotation taken out, over what the Cramér-Rao bound of the centroids allows. "
        "Errors / sd tells whether the reported covariance is honest: 1 expected, but for luck.",
        "**Time.** Of one thread, median over runs, identification left out. Absolute times belong "
        f"to the machine ({_escaped(words(document.get('machine')))}); other work on it "
        "may have slowed them down, their ratios less.",
        "**Memory.** Bytes of the arrays that must be kept: by a batch fit the stars of all "
        "frames, what the residual makes of them and its derivatives, growing with the frames; by "
        "a filter its state with the window of latest frames, which does not grow. The smoother "
        "goes through the frames several times, so they must be stored as well.",
        f"**Bad start.** {count(robust.get('runs'))} runs of "
        f"{count(robust.get('frames'))} frames of {words(robust.get('sensor_id'))} start with "
        f"normal errors of {starts} sigma in every parameter (the same direction for all), sigma "
        "being the spread from unit to unit in its configuration.",
        f"**False matches.** In as many runs, {shares} of the matched stars of each exposure get "
        "the direction of a wrong star: as often a neighbour 1 to 5 mrad off as another star of "
        "the same exposure. The fit's own screening is on; the rematching of "
        "the commands, which would drop false matches as well, is not.",
        "A run ends well within "
        f"{significant(document.get('well'), 3)} times the bound. A fit that raises an error or "
        "does not converge counts as refused. **The rule.** " + _escaped(content.rule(document)),
    ]


def write_page(document: Document, path: Path, command: str) -> None:
    """Write the page, and its plots beside it."""
    drawn = {
        "accuracy": figures.accuracy_and_time(document, f"{path.stem}-accuracy"),
        "robustness": figures.robustness(document, f"{path.stem}-robustness"),
    }
    for kind, svg in drawn.items():
        if svg is not None:
            write_text(path.with_name(f"{path.stem}-{kind}.svg"), _standalone(svg))
    write_text(path, page(document, path.stem, command))


def _standalone(svg: str) -> str:
    """Return an inline picture as a file of its own, on white for dark pages too."""
    head = '<svg xmlns="http://www.w3.org/2000/svg" '
    return (
        svg.replace("<svg ", head, 1).replace("max-width:", "background:#fff;max-width:", 1) + "\n"
    )
