"""What every study command ends with: its document, its report, and its tables."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stcal.cli.output import emit, write_documents

if TYPE_CHECKING:
    from rich.console import Console

DOCUMENT, REPORT = "study.json", "report.html"


def finish(
    document: dict[str, Any],
    out: Path,
    as_json: bool,
    tables: Callable[[dict[str, Any], Console], None],
) -> None:
    """Write study.json and report.html into ``out`` and print the document or its tables."""
    from rich.text import Text

    report = out / REPORT

    def human(console: Console) -> None:
        tables(document, console)
        console.print(Text(f"report: {report}"), soft_wrap=True)

    write_documents(document, out / DOCUMENT, report)
    emit(document, as_json, human)
