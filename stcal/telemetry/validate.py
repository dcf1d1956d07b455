"""Rows of text to typed runs and stars; what is wrong goes to quarantine with its reason.

A fault of a star refuses its row and leaves the frame its other stars.  A fault of the frame
refuses the run: every neighbouring row with the same sensor and frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stcal.frames import Bools, Floats, Ints
from stcal.telemetry import values
from stcal.telemetry.block import RowBlock
from stcal.telemetry.columns import FLAGS, FRAME_NUMBERS, STAR_COLUMNS, VECTORS
from stcal.telemetry.quarantine import TRUNCATED, Rejection
from stcal.telemetry.sensors import Sensors

# A quaternion as near to unit norm as double precision gets is left as it is: exact round trips.
_UNIT_NORM_PRECISION = 1e-12

RUN = np.dtype(
    [
        ("sensor", np.int64),
        ("frame_id", np.int64),
        ("t_tai_ns", np.int64),
        ("best_exposure", np.int8),
        ("eclipse", np.bool_),
        ("intrusion", np.bool_),
        ("numbers", np.float64, (len(FRAME_NUMBERS),)),
        ("alone", np.bool_),  # a version of its frame by itself, never joined with other runs
        ("row", np.int64),  # first line
        ("rows", np.int64),  # rows taken, those of stars and those that only carry the frame
    ]
)
STAR = np.dtype(
    [
        ("run", np.int64),
        ("row", np.int64),
        ("exposure", np.int8),
        ("row_px", np.float64),
        ("col_px", np.float64),
        ("intensity", np.float64),
        ("star_id", np.int64),
    ]
)

_CODE_OF = {
    **dict.fromkeys(VECTORS["q_si"], "bad_quaternion"),
    **dict.fromkeys(VECTORS["rate_deg_s"], "bad_rate"),
    **dict.fromkeys((*VECTORS["pos_km"], *VECTORS["vel_km_s"]), "bad_state"),
    "temperature_c": "bad_temperature",
}

Describe = Callable[[int], str]


@dataclass
class _Faults:
    """The first fault of every row, as an index into the list of checks."""

    first: Ints
    checks: list[tuple[str, Describe]] = field(default_factory=list)

    def add(self, code: str, bad: Bools, describe: Describe) -> None:
        if bad.any():
            self.first[(self.first < 0) & bad] = len(self.checks)
            self.checks.append((code, describe))

    def at(self, i: int) -> tuple[str, str]:
        code, describe = self.checks[self.first[i]]
        return code, describe(i)


def validate(block: RowBlock, sensors: Sensors) -> tuple[Any, Any, list[Rejection]]:
    """Return the block's good runs (RUN records), their stars (STAR records), and the rest.

    ``STAR["run"]`` counts in the runs returned.  Centroids have the sensor's first pixel centre
    subtracted, quaternions within the tolerance are normalised.
    """
    if not len(block):
        return np.empty(0, RUN), np.empty(0, STAR), list(block.rejected)
    text = {name: values.strip(column) for name, column in block.columns.items()}
    faults = _Faults(np.full(len(text["frame_id"]), -1))
    frame = _frame_values(block, text, sensors, faults)
    bad_run = np.zeros(int(block.run[-1]) + 1, dtype=np.bool_)
    bad_run[block.run[(faults.first >= 0)[block.frame_index]]] = True
    frame_bad = bad_run[block.run]
    star_faults = _Faults(np.full(len(block), -1))
    sensor = frame["sensor"][block.frame_index]
    stars, is_marker = _star_values(block, text, sensors, sensor, star_faults)
    star_bad = (star_faults.first >= 0) & ~frame_bad
    rejected = [
        *block.rejected,
        *_frame_rejections(block, text, faults, np.flatnonzero(frame_bad)),
        *_star_rejections(block, text, star_faults, np.flatnonzero(star_bad)),
    ]
    good = ~frame_bad & ~star_bad
    first = _first_rows(block)
    runs = frame[block.frame_index[first]]
    runs["row"] = block.row[first]
    runs["rows"] = np.bincount(block.run[good], minlength=len(runs))
    stars["run"] = (np.cumsum(~bad_run) - 1)[block.run]
    return runs[~bad_run], stars[good & ~is_marker], rejected


def _frame_values(block: RowBlock, text: dict[str, Any], sensors: Sensors, faults: _Faults) -> Any:
    """Return a RUN record for each value of the frame's columns, and note their faults."""
    frame = np.zeros(len(text["frame_id"]), RUN)

    def shown(name: str, what: str) -> Describe:
        return lambda i: f"{name} is {text[name][i].as_py()!r}, {what}"

    frame["sensor"], problem = sensors.look_up(text["sensor_id"])
    for code, what in sensors.PROBLEMS.items():
        faults.add(code, problem == code, shown("sensor_id", what))
    frame["frame_id"], bad = values.integers(text["frame_id"])
    faults.add("bad_frame_id", bad, shown("frame_id", "not an integer of at most 18 digits"))
    frame["t_tai_ns"], bad = values.times(text["time_utc"])
    faults.add("bad_time", bad, shown("time_utc", "not a UTC time as 2026-01-05T12:00:00.000Z"))
    frame["best_exposure"], bad = _exposure(text["best_exposure"])
    bad &= ~values.is_empty(text["best_exposure"])
    faults.add("bad_best_exposure", bad, shown("best_exposure", "neither 0, 1 nor empty"))
    _frame_numbers(frame, text, sensors, faults, shown)
    for name in FLAGS:
        frame[name], bad = values.flags(text[name])
        faults.add("bad_flag", bad, shown(name, "neither 0, 1 nor empty"))
    frame["alone"] = block.lines_are_frames and not block.frames_span_lines
    if block.truncated_run:
        last = np.zeros(len(frame), dtype=np.bool_)
        last[block.frame_index[block.run == block.run[-1]]] = True
        faults.add(TRUNCATED, last, lambda i: "the file ends before it shows that this is whole")
    if block.frame is None:
        _check_agreement(block, frame, faults)
    return frame


def _first_rows(block: RowBlock) -> Ints:
    """Return the first row of every run."""
    return np.flatnonzero(np.diff(block.run, prepend=-1))


def _frame_numbers(
    frame: Any,
    text: dict[str, Any],
    sensors: Sensors,
    faults: _Faults,
    shown: Callable[[str, str], Describe],
) -> None:
    codes = {"q_si": "bad_quaternion", "rate_deg_s": "bad_rate"}
    code_of = {
        name: codes.get(key, "bad_state") for key, names in VECTORS.items() for name in names
    }
    for i, name in enumerate(FRAME_NUMBERS):
        frame["numbers"][:, i], bad = values.numbers(text[name])
        code = code_of.get(name, "bad_temperature")
        faults.add(code, bad, shown(name, "not a finite number"))
    for key in ("pos_km", "vel_km_s"):
        some, every = _presence(frame["numbers"][:, _places(key)])
        faults.add("bad_state", some & ~every, lambda i, key=key: f"{key} is partly empty")  # type: ignore[misc]
    _check_quaternion(frame, sensors, faults)


def _check_quaternion(frame: Any, sensors: Sensors, faults: _Faults) -> None:
    q = frame["numbers"][:, _places("q_si")]
    some, every = _presence(q)
    faults.add("bad_quaternion", some & ~every, lambda i: "the quaternion is partly empty")
    with np.errstate(over="ignore", invalid="ignore"):
        norm = np.sqrt(np.sum(q * q, axis=1))
        off = np.abs(norm - 1.0)
        bad = every & ~(off <= sensors.quaternion_norm_tolerance[frame["sensor"]])
        rescale = every & (off > _UNIT_NORM_PRECISION) & ~bad
        q[rescale] /= norm[rescale, None]
    frame["numbers"][:, _places("q_si")] = q
    faults.add("bad_quaternion", bad, lambda i: f"the quaternion's norm is {norm[i]:.9g}, not 1")


def _check_agreement(block: RowBlock, frame: Any, faults: _Faults) -> None:
    """Every row of a run must say the same about its frame as the run's first row does."""
    first = _first_rows(block)[block.run]
    differs = np.zeros(len(frame), dtype=np.bool_)
    named = ("t_tai_ns", "best_exposure", *FLAGS)
    for name in named:
        differs |= frame[name] != frame[name][first]
    numbers = frame["numbers"]
    unequal = (numbers != numbers[first]) & ~(np.isnan(numbers) & np.isnan(numbers[first]))
    differs |= unequal.any(axis=1)

    def describe(i: int) -> str:
        names = [name for name in named if frame[name][i] != frame[name][first[i]]]
        names += [name for name, odd in zip(FRAME_NUMBERS, unequal[i], strict=True) if odd]
        return f"{', '.join(names)}: not as in row {block.row[first[i]]} of the same frame"

    faults.add("inconsistent_frame", differs, describe)


def _star_values(
    block: RowBlock, text: dict[str, Any], sensors: Sensors, sensor: Ints, faults: _Faults
) -> tuple[Any, Bools]:
    """Return STAR records (n,) and which rows hold no star, and note the faults of the stars."""
    stars = np.zeros(len(block), STAR)

    def shown(name: str, what: str) -> Describe:
        return lambda i: f"{name} is {text[name][i].as_py()!r}, {what}"

    empty = {column.name: values.is_empty(text[column.name]) for column in STAR_COLUMNS}
    marker = empty["row_px"] & empty["col_px"] & empty["intensity"] & empty["star_id"]
    # In JSON an object stands for every star: an empty one is a broken star.
    marker &= empty["exposure"] | (not block.lines_are_frames)
    stars["exposure"], bad = _exposure(text["exposure"])
    bad &= ~(marker & empty["exposure"])
    faults.add("bad_exposure", bad, shown("exposure", "neither 0 nor 1"))
    for axis, size in (("row_px", sensors.rows), ("col_px", sensors.cols)):
        centroid, bad = values.numbers(text[axis])
        bad |= empty[axis] & ~marker
        faults.add("bad_centroid", bad, shown(axis, "not a finite number"))
        stars[axis] = centroid - sensors.first_pixel_centre_px[sensor]
        # The outer edges of the first and the last pixel.
        outside = (stars[axis] < -0.5) | (stars[axis] > size[sensor] - 0.5)
        limits = (sensors.first_pixel_centre_px - 0.5, sensors.first_pixel_centre_px + size - 0.5)
        faults.add("outside_detector", outside, _outside(axis, text, sensor, limits))
    stars["intensity"], bad = values.numbers(text["intensity"])
    faults.add("bad_intensity", bad, shown("intensity", "not a finite number"))
    stars["star_id"], bad = values.star_ids(text["star_id"])
    faults.add("bad_star_id", bad, shown("star_id", "neither HIP n nor TYC a-b-c"))
    stars["row"] = block.row
    return stars, marker


def _outside(
    axis: str, text: dict[str, Any], sensor: Ints, limits: tuple[Floats, Floats]
) -> Describe:
    def describe(i: int) -> str:
        low, high = (float(limit[sensor[i]]) for limit in limits)
        return f"{axis} is {text[axis][i].as_py()}, the detector has {low:g} to {high:g}"

    return describe


def _exposure(text: Any) -> tuple[Ints, Bools]:
    number, bad = values.integers(text)
    bad = bad | (number < 0) | (number > 1)
    return np.where(bad, -1, number), bad


def _places(key: str) -> list[int]:
    return [FRAME_NUMBERS.index(name) for name in VECTORS[key]]


def _presence(vector: Floats) -> tuple[Bools, Bools]:
    there = ~np.isnan(vector)
    return np.any(there, axis=1), np.all(there, axis=1)


def _frame_rejections(
    block: RowBlock, text: dict[str, Any], faults: _Faults, rows: Ints
) -> list[Rejection]:
    """Return a record a row of the refused runs; one a line where a line is a frame."""
    rejections: list[Rejection] = []
    run, run_rows, reason = -1, np.bincount(block.run), ("", "")
    # A row without a fault of its own is refused for the first fault of its run.
    faulty = np.flatnonzero((faults.first >= 0)[block.frame_index])
    _, first = np.unique(block.run[faulty], return_index=True)
    culprit = dict(zip(block.run[faulty[first]].tolist(), faulty[first].tolist(), strict=True))
    for i in rows.tolist():
        if block.run[i] == run and block.lines_are_frames:
            continue
        if block.run[i] != run:
            run = int(block.run[i])
            code, detail = faults.at(int(block.frame_index[culprit[run]]))
            where = "" if block.lines_are_frames else f" (row {block.row[culprit[run]]})"
            reason = (code, detail + where)
        count = int(run_rows[run]) if block.lines_are_frames else 1
        rejections.append(_rejection(block, text, i, *reason, rows=count))
    return rejections


def _star_rejections(
    block: RowBlock, text: dict[str, Any], faults: _Faults, rows: Ints
) -> list[Rejection]:
    """Return a record a refused star; one a line and reason where a line is a frame.

    The record of a line holds the whole of it, and the line may hold many broken stars.
    """
    if not block.lines_are_frames:
        return [_rejection(block, text, i, *faults.at(i)) for i in rows.tolist()]
    first = _first_rows(block)[block.run]
    alike: dict[tuple[int, str], list[int]] = {}
    for i in rows.tolist():
        alike.setdefault((int(block.run[i]), faults.at(i)[0]), []).append(i)
    rejections = []
    for members in alike.values():
        code, detail = faults.at(members[0])
        more = f", and {len(members) - 1} more of its stars" if len(members) > 1 else ""
        place = members[0] - int(first[members[0]]) + 1
        detail = f"star {place}: {detail}{more}"
        rejections.append(_rejection(block, text, members[0], code, detail, rows=len(members)))
    return rejections


def _rejection(
    block: RowBlock, text: dict[str, Any], i: int, code: str, detail: str, rows: int = 1
) -> Rejection:
    record = int(block.frame_index[i])
    sensor_id, frame_id = (text[name][record].as_py() for name in ("sensor_id", "frame_id"))
    row, offset = int(block.row[i]), int(block.offset[i])
    return Rejection(row, code, detail, block.raw(i), offset, rows, sensor_id, frame_id)
