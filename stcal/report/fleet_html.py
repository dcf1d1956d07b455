"""The HTML index of a fleet's recalibration, with a link to each sensor's report."""

from __future__ import annotations

from urllib.parse import quote

from stcal.report import fleet_content
from stcal.report.document import Document, sections, text
from stcal.report.layout import page


def render(document: Document) -> str:
    """Return the HTML index (schema ``stcal.fleet/1``), beside the folders of the sensors."""
    found = sections(document.get("sensors"))
    fleet = fleet_content.fleet_table(document)
    # Without the first slashes a name cannot lead to another host.
    links = [quote(text(item.get("report")).lstrip("/")) or None for item in found]
    return page(
        "fleet.html.j2",
        heading="Recalibration of a fleet",
        verdicts=[fleet_content.fleet_verdict(document)],
        fleet=fleet,
        rows=list(zip(fleet.rows, links, strict=True)),
        steps=fleet_content.step_table(document),
        facts=[
            ("Plan", text(document.get("plan"))),
            ("Plan SHA-256", text(document.get("plan_sha256"))),
            ("Software", text(document.get("software"))),
            ("Exit code", str(document.get("exit_code"))),
        ],
    )
