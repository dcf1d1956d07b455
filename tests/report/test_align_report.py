"""The report of an alignment, from a document alone, whole or hollow."""

import copy
import io
import warnings

import numpy as np
import pytest
from rich.console import Console

from stcal.report.align_report import alignment_tables, render_alignment

STOPS = 12


def method(shift):
    spread = np.geomspace(900.0, 3.0, STOPS)[:, None] * [1.0, 1.1, 8.0]
    return {
        "angles_deg": [[1.0 + shift, 2.0, 3.0]] * STOPS,
        "departure_arcsec": (0.5 * spread - 0.5 * spread[-1]).tolist(),
        "sd_arcsec": spread.tolist(),
    }


def last(shift):
    return {
        "c_sb": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        "q_sb": [0.0, 0.0, 0.0, 1.0],
        "angles_deg": {"roll": 1.0 + shift, "pitch": -12.345678, "yaw": 3.0},
        "covariance_rad2": (np.eye(3) * 1e-10).tolist(),
        "sd_arcsec": [0.41, 0.52, 3.6],
        "from_multiplicative_arcsec": [0.11 * shift, 0.0, -1.25],
    }


@pytest.fixture
def document():
    return {
        "schema": "stcal.alignment/1",
        "sensor_id": "ST16-1",
        "software": "stcal 0.0 (synthetic)",
        "created_utc": "2026-01-06T00:00:00Z",
        "verdict": {"accepted": True, "reasons": [], "notes": ["a note"]},
        "method": "multiplicative",
        "result": last(0.0),
        "methods": {"linear": last(0.25), "multiplicative": last(0.0)},
        "body": {"file": "body.csv", "maximum_gap_s": 10.0},
        "span": {"from": "2026-01-05T00:00:00.000Z", "to": "2026-01-05T06:00:00.000Z"},
        "frames": 1200,
        "frames_identified": 1100,
        "frames_with_attitude": 1000,
        "frames_used": 990,
        "frames_rejected": 10,
        "stars_used": 12345,
        "stars_rejected": 67,
        "rms_residual_urad": 101.25,
        "nis": {"mean": 3.25, "expected": 2.99, "interval": [2.7, 3.3], "confidence": 0.95},
        "noise": {
            "stars": 1.23,
            "frames": [1.11, 1.22, 1.33],
            "correlation": [1.0, 1.0, 1.05],
            "attitude_excess_urad": 9.87,
        },
        "history": {
            "time_utc": ["2026-01-05T00:00:00.000Z"] * STOPS,
            "elapsed_s": np.geomspace(40.0, 20000.0, STOPS).tolist(),
            "frames": list(range(2, 2 + STOPS)),
            "linear": method(0.25),
            "multiplicative": method(0.0),
        },
        "calibration_serial": 2,
        "provenance": {"telemetry_sha256": "a" * 64},
    }


def printed(document):
    stream = io.StringIO()
    alignment_tables(document, Console(file=stream, width=100))
    return stream.getvalue()


def test_the_page_starts_with_the_verdict_and_shows_everything(document):
    html = render_alignment(document)
    assert html.index("Alignment accepted") < html.index("<h1>Alignment of ST16-1")
    for shown in ("\N{MINUS SIGN}12.3457", "0.41", "101.2 µrad", "2.99 (2.70 to 3.30)", "a note",
                  "body.csv", "a" * 64, "1.11, 1.22, 1.33", "9.9 µrad"):  # fmt: skip
        assert shown in html, shown
    assert html.count("<svg") == 1
    assert "http" not in html.replace("http://www.w3.org", "")


def test_the_same_document_gives_the_same_bytes(document):
    assert render_alignment(document) == render_alignment(copy.deepcopy(document))


def test_the_terminal_shows_the_same_tables(document):
    text = printed(document)
    assert "ST16-1: Alignment accepted" in text
    for shown in ("Linear", "Multiplicative", "1.2500", "C_SB row y", "12\u202f345"):
        assert shown in text, shown


def test_a_refused_alignment_has_no_result(document):
    document["result"] = None
    document["verdict"] = {"accepted": False, "reasons": ["<b>why</b>"], "notes": []}
    html = render_alignment(document)
    assert "Alignment refused" in html
    assert "&lt;b&gt;why&lt;/b&gt;" in html
    result = html[html.index("<h3>Result</h3>") :]
    assert result.count("not available", 0, result.index("<h3>Agreement")) == 2


@pytest.mark.parametrize("gone", ["methods", "history", "nis", "noise", "span", "verdict"])
def test_what_is_missing_is_not_available(document, gone):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for hollow in ({}, None, "odd"):
            html = render_alignment(document | {gone: hollow})
            assert "not available" in html
            assert printed(document | {gone: hollow})


def test_a_document_without_anything_still_gives_a_report():
    assert "not available" in render_alignment({"schema": "stcal.alignment/1"})


@pytest.mark.parametrize("odd", [[], [[1.0, 2.0]], [[1.0, 2.0, 3.0]], [None], "x", 3])
def test_an_odd_history_draws_no_figure(document, odd):
    for name in ("linear", "multiplicative"):
        document["history"][name]["sd_arcsec"] = odd
    assert "<svg" not in render_alignment(document)


def test_one_method_alone_is_drawn(document):
    del document["history"]["linear"]
    assert "<svg" in render_alignment(document)
