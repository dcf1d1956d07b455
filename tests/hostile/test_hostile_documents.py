"""Documents from elsewhere: calibrations, plans, targets, reports."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

from stcal.calibration import Calibration, file_text, load, save
from stcal.cli import main
from stcal.errors import InputError
from stcal.reading import read_json_object, read_toml

ROOT = Path(__file__).parents[2]
INITIAL = ROOT / "sample_telemetry" / "ST16-1.initial.json"


@pytest.fixture
def fitted(tmp_path):
    first = load(INITIAL)
    covariance = np.eye(len(first.camera.parameters))
    path = tmp_path / "calibration.json"
    save(Calibration(first.sensor_id, 2, first.camera, first.c_sd, covariance), path)
    return path


def test_a_changed_digit_of_a_fitted_calibration_is_seen(fitted):
    text = fitted.read_text()
    assert load(fitted).serial == 2
    digits = [m.start() for m in re.finditer(r"\d", text)]
    for place in digits[:: max(1, len(digits) // 60)]:
        other = "1" if text[place] != "1" else "2"
        changed = text[:place] + other + text[place + 1 :]
        fitted.write_text(changed)
        if '"sha256"' not in changed or json.loads(changed) == json.loads(text):
            continue  # the name of the hash; the 17th digit of a number, which may be any
        with pytest.raises(InputError) as error:
            load(fitted)
        assert str(fitted) in str(error.value)


def test_layout_and_order_of_a_calibration_do_not_matter(fitted):
    document = json.loads(fitted.read_text())
    fitted.write_text(json.dumps(dict(reversed(document.items()))))
    assert load(fitted).serial == 2
    del document["sha256"]
    document["serial"] = 3  # changed on purpose
    fitted.write_text(json.dumps(document))
    assert load(fitted).serial == 3


def test_the_minimal_form_has_no_hash():
    assert "sha256" not in json.loads(file_text(load(INITIAL)))


@pytest.mark.parametrize(
    "content",
    [b"[" * 100_000, b'{"a":' * 100_000, b"1" * 5000, b"\xff{}"],
)
def test_json_that_is_no_document(tmp_path, content):
    path = tmp_path / "a.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match=re.escape(str(path))):
        read_json_object(path)


@pytest.mark.skipif(not os.path.exists("/dev/zero"), reason="no endless file here")
@pytest.mark.parametrize("read", [read_json_object, read_toml])
def test_a_file_without_end(read):
    with pytest.raises(InputError, match="longer than"):
        read(Path("/dev/zero"))


@pytest.mark.parametrize("name", ["\0", "a" * 300, "x/" * 3000 + "y"])
def test_names_that_no_file_can_have(tmp_path, name):
    with pytest.raises(InputError):
        read_json_object(tmp_path / name)


def test_a_report_of_texts_that_are_no_unicode(tmp_path):
    document = {"schema": "stcal.fit/1", "sensor_id": "\ud800<script>alert(1)</script>"}
    (tmp_path / "fit.json").write_text(json.dumps(document))
    out = tmp_path / "report.html"
    assert main(["report", str(tmp_path / "fit.json"), "--out", str(out)]) == 0
    assert "<script" not in out.read_text()
    assert "&lt;script&gt;" in out.read_text()
