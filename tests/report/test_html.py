from __future__ import annotations

import json
import re
import subprocess
import sys
import warnings
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from sample_documents import fit_document, hollow, validation_document

from stcal.cli import main
from stcal.errors import InputError
from stcal.report.html import (
    render_fit,
    render_recalibration,
    render_validation,
    write_report,
)

VOID = {"meta", "br", "hr", "img", "link", "input"}
ATTACK = '<script>alert("1")</script>'


class Page(HTMLParser):
    """Collects text and checks that tags nest; SVG's empty tags close themselves."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.body: list[str] = []
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "body" in self.open and data.strip() and not {"style", "title"} & set(self.open):
            self.body.append(data.strip())

    def count(self, tag: str) -> int:
        return sum(name == tag for name, _ in self.tags)


@cache
def fit_page() -> str:
    return render_fit(fit_document())


@cache
def both_pages() -> str:
    return render_recalibration(fit_document(), validation_document())


def test_fit_report_starts_with_its_verdict() -> None:
    document = fit_document()
    page = Page(fit_page())
    assert page.body[:2] == ["Fit accepted", "Recalibration of ST16-1"]
    assert page.count("svg") == 8
    for shown in ("422.6", "80.3", "0.190", "15.98712", "b4 [10⁸ m⁻⁴]", "+1.35", "2\u202f400"):
        assert shown in page.body
    assert document["observability"] in page.body
    assert "a" * 64 in page.body
    # The first cycle has none before it to compare with.
    assert page.body.count("not available") == 1


def test_refused_with_every_reason() -> None:
    document = validation_document()
    document["verdict"] = {
        "accepted": False,
        "reasons": ["first reason", "second"],
        "notes": ["note"],
    }
    html = render_validation(document)
    page = Page(html)
    assert page.body[:4] == ["Validation refused", "first reason", "second", "note"]
    assert 'class="verdict refused"' in html
    for shown in ("44.1 % (35.2 to 53.1)", "2.461 (2.110 to 2.930)", "89.9 (86.0 to 94.0)"):
        assert shown in page.body
    assert page.count("svg") == 4


@pytest.mark.parametrize("value", [None, "true", 1, 0])
def test_only_a_boolean_is_a_verdict(value: object) -> None:
    document = fit_document()
    document["verdict"]["accepted"] = value
    assert Page(render_fit(document)).body[0] == "Fit: verdict not available"


def test_both_verdicts_first() -> None:
    page = Page(both_pages())
    assert page.body[:2] == ["Validation accepted", "Fit accepted"]
    assert page.count("svg") == 12


def test_identifiers_are_unique_and_every_reference_resolves() -> None:
    html = both_pages()
    identifiers = re.findall(r'\sid="([^"]+)"', html)
    assert len(identifiers) == len(set(identifiers)) > 0
    assert set(re.findall(r'(?:href="#|url\(#)([^")]+)', html)) == set(identifiers)


def test_two_sensors_do_not_mix() -> None:
    with pytest.raises(InputError, match="ST16-2"):
        render_recalibration(fit_document(), validation_document() | {"sensor_id": "ST16-2"})


def test_nothing_from_outside_and_no_script() -> None:
    html = both_pages()
    page = Page(html)
    assert "http" not in html
    assert "src=" not in html
    assert "@import" not in html
    assert re.findall(r"url\((?!#)", html) == []
    assert re.findall(r'href="(?!#)', html) == []
    assert page.count("script") == page.count("link") == 0


def test_strings_are_escaped_everywhere() -> None:
    document = _attacked(fit_document())
    document["schema"] = "stcal.fit/1"
    page = Page(render_fit(document))
    assert page.count("script") == 0
    assert any(ATTACK in line for line in page.body)
    named = fit_document()
    for parameter in named["parameters"]:
        parameter["name"] = f"{ATTACK}$x$_px"
    html = render_fit(named)
    assert Page(html).count("script") == 0
    # Once per table and figure, and never read as a formula.
    assert html.count("&lt;/script&gt;$x$") > 8


def _attacked(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _attacked(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_attacked(item) for item in value]
    return ATTACK if isinstance(value, str) else value


def test_bytes_are_reproducible_in_another_process(tmp_path: Path) -> None:
    path = tmp_path / "fit.json"
    path.write_text(json.dumps(fit_document()))
    (tmp_path / "matplotlibrc").write_text("axes.xmargin: 0.4\nxtick.major.size: 9\n")
    code = (
        "import json, sys; from stcal.report.html import render_fit;"
        "sys.stdout.buffer.write(render_fit(json.load(open(sys.argv[1]))).encode())"
    )
    other = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, check=True, cwd=tmp_path
    )
    assert other.stdout == fit_page().encode()


@pytest.mark.parametrize(
    ("document", "render", "figures"),
    [
        (hollow(fit_document()), render_fit, 8),
        ({"schema": "stcal.fit/1"}, render_fit, 8),
        (hollow(validation_document()), render_validation, 4),
        ({"schema": "stcal.validation/1"}, render_validation, 4),
    ],
)
def test_null_and_empty_still_render(document: Any, render: Any, figures: int) -> None:
    page = Page(render(document))
    assert page.count("svg") == 0
    assert page.body.count("not available") >= figures
    assert "nan" not in " ".join(page.body).lower().split()
    assert "None" not in page.body


@pytest.mark.parametrize("junk", ["text", 3, [1, "x", None], {"a": [{}]}, True, [[[]]], -1e308])
def test_any_section_of_another_type_still_renders(junk: object) -> None:
    for document, render in (
        (fit_document(9), render_fit),
        (validation_document(9), render_validation),
    ):
        replaced = dict.fromkeys(document, junk)
        Page(render(replaced))
        nested = {
            key: dict.fromkeys(value, junk) if isinstance(value, dict) else value
            for key, value in document.items()
        }
        Page(render(nested))


def test_large_inputs_stay_small() -> None:
    assert len(render_fit(fit_document(50_000))) < 400_000


def test_write_report_picks_by_schema(tmp_path: Path) -> None:
    for document in (fit_document(), validation_document()):
        write_report(document, tmp_path / "r.html")
        assert document["schema"].split(".")[1][:3] in (tmp_path / "r.html").read_text().lower()
    with pytest.raises(InputError, match="no report for schema 'x/1'"):
        write_report({"schema": "x/1"}, tmp_path / "none.html")
    assert not (tmp_path / "none.html").exists()


def test_command_equals_the_core(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fit, validation = tmp_path / "fit.json", tmp_path / "validation.json"
    fit.write_text(json.dumps(fit_document()))
    validation.write_text(json.dumps(validation_document()))
    out = tmp_path / "sub" / "r.html"
    assert main(["report", str(fit), "--out", str(out)]) == 0
    assert out.read_text() == fit_page()
    capsys.readouterr()
    assert main(["report", str(validation), str(fit), "--out", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["report"] == str(out)
    assert out.read_text() == both_pages()


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("", "not JSON"),
        ("[]", "not an object"),
        ('{"schema": "stcal.calibration/1"}', "stcal.calibration/1"),
    ],
)
def test_bad_document_is_bad_input(
    content: str, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "x.json", tmp_path / "x.html"
    path.write_text(content)
    assert main(["report", str(path), "--out", str(out)]) == 3
    message = capsys.readouterr().err
    assert str(path) in message
    assert reason in message
    assert not out.exists()


def test_two_fits_are_a_usage_error(tmp_path: Path) -> None:
    path = tmp_path / "fit.json"
    path.write_text(json.dumps(fit_document(5)))
    assert main(["report", str(path), str(path), "--out", str(tmp_path / "x.html")]) == 2


def _scaled(value: Any, size: float) -> Any:
    """Every number of a document as large as this, signs kept."""
    if isinstance(value, dict):
        return {key: _scaled(item, size) for key, item in value.items()}
    if isinstance(value, list):
        return [_scaled(item, size) for item in value]
    if isinstance(value, int | float) and not isinstance(value, bool):
        return size if value >= 0 else -size
    return value


@pytest.mark.parametrize("size", [1e300, -1.7e308, 1e12, 5e-324])
def test_extreme_numbers_render_without_warnings(size: float) -> None:
    for document, render in (
        (fit_document(20), render_fit),
        (validation_document(20), render_validation),
    ):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert "<svg" in render(_scaled(document, size))
            # And each by itself: figures of the others would be the same again.
            for key in ("field", "cycles", "radial", "parameters", "singular_values"):
                if key in document:
                    Page(render(hollow(document) | {key: _scaled(document[key], size)}))


def test_documents_of_two_sensors_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fit, validation = tmp_path / "f.json", tmp_path / "v.json"
    fit.write_text(json.dumps(fit_document()))
    validation.write_text(json.dumps({**validation_document(), "sensor_id": "OTHER"}))
    # In either order on the command line.
    command = ["report", str(validation), str(fit), "--out", str(tmp_path / "r.html")]
    assert main(command) == 3
    told = capsys.readouterr().err
    assert f"{validation} of sensor 'OTHER'" in told
    assert f"{fit} is of sensor" in told


def test_out_below_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document = tmp_path / "f.json"
    document.write_text(json.dumps(fit_document()))
    out = document / "x" / "r.html"
    assert main(["report", str(document), "--out", str(out)]) == 3
    assert f"stcal: {out}: " in capsys.readouterr().err
