"""Fields parsed by the compiled loops mean what they mean as text."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
import telemetry_cases as cases
from hypothesis import given, settings
from hypothesis import strategies as st

from stcal.telemetry import csv
from stcal.telemetry.columns import COLUMNS
from stcal.telemetry.sensors import Sensors
from stcal.telemetry.sources import examine
from stcal.telemetry.validate import validate

NUMBERS = ["", "0", "-0", "-0.0", "12.125", "1943.4999", "-0.5", "-0.51", "5.", ".5", "+3.25"]
NUMBERS += ["007.5", "1e2", "1.5E-3", " 7.25 ", "nan", "inf", "1e400", "1.2.3", "-", "--1", "x"]
NUMBERS += ["0.1234567890123456789", "123456789012345", "1234567890123456", "2591.499999999999"]
IDS = ["", "HIP 1", "HIP 027989", "HIP 200000", "HIP 200001", "HIP 0", "HIP 0000001", "27989"]
IDS += ["TYC 129-1873-1", "hip 1", "HIP  5", " HIP 7 ", "HIP 7x", "HIP ", "HIP1"]
TEXTS = {
    "exposure": ["0", "1", "0.0", "1.00", "1.", "", "2", "-1", "0.5", " 1", "one"],
    "row_px": NUMBERS,
    "col_px": NUMBERS,
    "intensity": NUMBERS,
    "star_id": IDS,
}
FRAMES = {
    "sensor_id": ["ST16-1", "ST16-1", "ST16-1", " ST16-1", "?", ""],
    "frame_id": ["7", "8", "7.0", "x", ""],
    "q_x": ["0.5", "0.50", "0.9", "", "x"],
    "temperature_c": ["20.5", "", "hot"],
    "eclipse": ["", "0", "1", "2"],
}
# Mostly good, so that many a row has one odd field only and its star is kept.
STAR = st.fixed_dictionaries(
    {
        name: st.sampled_from(texts + [cases.ROW[name]] * (3 * len(texts)))
        for name, texts in TEXTS.items()
    }
)
FRAME = st.fixed_dictionaries(
    {name: st.sampled_from([texts[0]] * 4 + texts) for name, texts in FRAMES.items()}
)
RUNS = st.lists(st.tuples(FRAME, st.lists(STAR, min_size=1, max_size=5)), min_size=1, max_size=6)


def checked(path, block_bytes):
    """Return all that validation makes of a file."""
    sensors = Sensors([cases.config()])
    parts = [
        (block, *validate(block, sensors))
        for block in csv.decode(examine(path), print, block_bytes)
    ]
    records = [record for _, _, _, rejected in parts for record in rejected]
    return [(runs.tobytes(), stars.tobytes()) for _, runs, stars, _ in parts], records, parts


@settings(max_examples=100, deadline=None)
@given(runs=RUNS, block_bytes=st.sampled_from([300, 1000, 100_000]))
def test_compiled_and_general_way_agree(runs, block_bytes):
    names = [column.name for column in COLUMNS]
    rows = [cases.ROW | frame | star for frame, stars in runs for star in stars]
    lines = [",".join(names), *(",".join(row.get(name, "") for name in names) for row in rows)]
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        path = Path(folder) / "a.csv"
        path.write_text("\n".join(lines) + "\n")
        compact, records, _ = checked(path, block_bytes)
        patch.setattr(csv, "runs_of", lambda fields, known: None)
        as_text, expected, parts = checked(path, block_bytes)
        assert all(block.frame is None for block, *_ in parts)
        assert records == expected
        assert compact == as_text


def test_frames_are_parsed_once_where_their_bytes_repeat(tmp_path):
    rows = [row for f in range(5) for row in cases.rows(4, frame_id=str(f))]
    _, records, ((block, runs, stars, _),) = checked(
        cases.write_rows(tmp_path / "a.csv", rows), 1 << 20
    )
    assert block.frame is not None
    assert len(block.columns["q_x"]) == len(runs) == 5
    assert len(stars) == 20
    assert records == []
    rows[6]["temperature_c"] = "20.50"
    _, records, ((block, runs, *_),) = checked(cases.write_rows(tmp_path / "b.csv", rows), 1 << 20)
    assert block.frame is None
    assert len(runs) == 5
    assert records == []


@pytest.mark.parametrize("digits", range(1, 18))
def test_numbers_are_the_nearest_doubles(tmp_path, digits):
    rng = np.random.default_rng(digits)
    texts = []
    for value in rng.uniform(0, 1000, 200).tolist():
        texts.append(f"{value:.{digits}g}" if digits <= 15 else f"{value:.{digits}g}"[:18])
    rows = [cases.ROW | {"row_px": text} for text in texts if "e" not in text]
    _, records, ((_, _, stars, _),) = checked(cases.write_rows(tmp_path / "a.csv", rows), 1 << 20)
    assert records == []
    assert stars["row_px"].tolist() == [float(row["row_px"]) for row in rows]
