"""The page of a report: tables and pictures in reading order, rendered by a template."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stcal.report.content import Table, Verdict
from stcal.report.document import Document, text

_TEMPLATES = Path(__file__).parent / "templates"


@dataclass(frozen=True)
class Picture:
    """Figures side by side with a caption; None is a figure without data.

    Without a title it belongs to the table above it.
    """

    title: str
    caption: str
    svgs: tuple[str | None, ...]


@dataclass(frozen=True)
class Part:
    """One document, or a chapter of it, laid out: tables and pictures in reading order."""

    title: str
    items: tuple[Table | Picture, ...]


def page(template: str, **values: Any) -> str:
    """Return the HTML page that a template makes of a heading, parts, and its other values."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # The figures' text was escaped when they were drawn; nothing else may pass unescaped.
    environment.filters["svg"] = Markup
    return environment.get_template(template).render(
        **values, is_table=lambda item: isinstance(item, Table)
    )


def heading(kind: str, document: Document) -> str:
    """Return the heading of a report of one sensor."""
    return f"{kind} of {text(document.get('sensor_id')) or 'an unnamed sensor'}"


def report_page(title: str, verdicts: Sequence[Verdict], parts: Sequence[Part]) -> str:
    """Return the HTML page of one or more documents of a sensor: their verdicts first."""
    return page(
        "report.html.j2",
        heading=title,
        verdicts=verdicts,
        parts=parts,
        several=len(parts) > 1,
    )
