"""Every report of a document whose every text, and every name within it, is markup."""

from __future__ import annotations

from typing import Any

import pytest
from sample_documents import fit_document, sequential_document, validation_document
from test_align_report import document as alignment  # noqa: F401
from test_conversion_report import conversion_document
from test_html import Page

from stcal.report import fleet_html, upload_html
from stcal.report.html import RENDERERS

ATTACKS = (
    "<script>alert(1)</script>",
    '"><script>alert(1)</script>',
    "'><img src=x onerror=alert(1)>",
    "</style></svg></title><script>alert(1)</script>",
    "]]><!--<script>alert(1)</script>",
    "javascript:alert(1)//<script>",
    "//elsewhere/<script>alert(1)</script>",
    "{{ 1234567 * 7 }}{% raw %}<script>",
    "$\\frac{1}{<script>}$",
)


def upload() -> dict[str, Any]:
    gate = {"passed": False, "reasons": ["r"], "override": "because", "figures": {"a": "b"}}
    field = {"name": "a", "holds": "f_m", "on_target": 1.0, "unit": "m", "word": "f64", "error": 0}
    return {
        "schema": "stcal.upload/1",
        "software": "stcal",
        "sensor_id": "ST16-1",
        "serial": 2,
        "parent": {"serial": 1, "sha256": "ab"},
        "data": {"fit": {"from": "a", "to": "b"}, "validation": {"from": "a", "to": "b"}},
        "target": {"name": "target", "sha256": "ab"},
        "crc16_arc": {"a.tbl": "0x1"},
        "files": {"a.tbl": {"sha256": "ab", "bytes": 3}},
        "gates": {"one": gate, "table": gate | {"figures": {"fields": [field]}}},
        "overrides": {"one": "because"},
    }


def fleet() -> dict[str, Any]:
    sensor = {
        "sensor_id": "ST16-1",
        "state": "refused",
        "message": "why",
        "upload": "up/load",
        "report": "ST16-1/report.html",
        "steps": [{"name": "fit", "exit_code": 0, "seconds": 1.0}],
    }
    ingest = {"exit_code": 4, "message": "m"}
    return {
        "schema": "stcal.fleet/1",
        "plan": "plan.toml",
        "plan_sha256": "ab",
        "software": "stcal",
        "exit_code": 4,
        "ingest": ingest,
        "sensors": [sensor, sensor],
    }


def attacked(value: Any, attack: str, names: bool = False) -> Any:
    """Return a document with every text, or every name of an entry, attacked."""
    if isinstance(value, dict):
        changed = {key: attacked(item, attack, names) for key, item in value.items()}
        return {key + attack: item for key, item in changed.items()} if names else changed
    if isinstance(value, list):
        return [attacked(item, attack, names) for item in value]
    return attack if isinstance(value, str) and not names else value


def harmless(html: str) -> None:
    """Check that a page holds no script, handler or outward link, and what is open is closed."""
    for tag, attributes in Page(html).tags:
        assert tag not in ("script", "iframe", "object", "embed", "link", "img", "base"), tag
        for name, value in attributes.items():
            assert not name.startswith("on"), (tag, name)
            if name in ("href", "xlink:href", "src", "action"):
                assert (value or "#").startswith("#") or _is_relative(value), (tag, value)
    assert "8641969" not in html


def _is_relative(link: str | None) -> bool:
    return link is not None and not link.startswith("/") and ":" not in link


@pytest.mark.parametrize("attack", ATTACKS)
def test_uploads_and_fleets(attack: str) -> None:
    for document, render in ((upload(), upload_html.render), (fleet(), fleet_html.render)):
        harmless(render(attacked(document, attack)))
        harmless(render(attacked(document, attack, names=True)))
    named = upload()
    named["files"] = {attack: {"sha256": attack, "bytes": attack}}
    named["gates"] = {attack: named["gates"]["one"]}
    named["overrides"] = {attack: attack}
    harmless(upload_html.render(named))


@pytest.mark.parametrize("schema", sorted(RENDERERS))
def test_any_document_given_to_any_report(schema: str) -> None:
    """Documents of the own kind where there is a sample, else of others."""
    bodies = {
        "stcal.fit/1": (fit_document(20), sequential_document(20)),
        "stcal.validation/1": (validation_document(20),),
        "stcal.conversion/1": (conversion_document(),),
    }.get(schema, (fit_document(20) | fleet(), validation_document(20) | upload()))
    for body, attack in zip(bodies, ATTACKS, strict=False):
        harmless(RENDERERS[schema](attacked(body, attack) | {"schema": schema}))


@pytest.mark.parametrize("attack", ATTACKS[:4])
def test_alignments(alignment: dict[str, Any], attack: str) -> None:  # noqa: F811
    render = RENDERERS["stcal.alignment/1"]
    harmless(render(attacked(alignment, attack)))
    harmless(render(attacked(alignment, attack, names=True)))
