"""Times that go backwards: frames whose time their neighbours in the source contradict.

Within one download the frame number rises with time, but a source may hold several downloads, in
any order, overlapping and repeated, and a restarted sensor counts anew.  Going back in time is
therefore no fault by itself.  What can be said: of three frames that follow each other with rising
numbers, when the outer two agree (the later number has the later time), the middle one's time lies
between theirs.  If it lies outside by more than the limit, before the earlier or behind the later,
it is the middle one that is wrong.  A seam of two downloads does not look like that, nor does a
clock that is set.  Of two neighbours that contradict each other only, the later is the one refused:
the time goes back there.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from stcal.frames import Bools, Floats
from stcal.telemetry.block import RowBlock
from stcal.telemetry.quarantine import TIME_BACKWARDS, Rejection
from stcal.telemetry.sensors import Sensors

_NS = 1e9


@dataclass(frozen=True)
class Validated:
    """A block, its good runs (RUN records) with their stars, and what was refused."""

    block: RowBlock
    runs: Any
    stars: Any
    rejected: list[Rejection]


def in_order(parts: Iterable[Validated], sensors: Sensors) -> Iterator[Validated]:
    """Yield the parts without the frames that their neighbours contradict; these are refused.

    A block's first and last frames are judged with those of the blocks beside it.
    """
    before: Any = None
    waiting: Validated | None = None
    for part in parts:
        if waiting is not None:
            yield _judged(waiting, before, part.runs, sensors)
            before = _latest(before, waiting.runs)
        waiting = part
    if waiting is not None:
        yield _judged(waiting, before, waiting.runs[:0], sensors)


def _latest(before: Any, runs: Any) -> Any:
    """Return the last run of every sensor met so far."""
    every = runs if before is None else np.concatenate([before, runs])
    _, from_end = np.unique(every["sensor"][::-1], return_index=True)
    return every[np.sort(len(every) - 1 - from_end)]


def _first_two(runs: Any) -> Any:
    """Return the first two runs of every sensor: what it takes to judge the one before them."""
    order = np.argsort(runs["sensor"], kind="stable")
    sensor = runs["sensor"][order]
    place = np.arange(len(runs)) - np.searchsorted(sensor, sensor)
    return runs[np.sort(order[place < 2])]


def _judged(part: Validated, before: Any, after: Any, sensors: Sensors) -> Validated:
    first = part.runs[:0] if before is None else before
    every = np.concatenate([first, part.runs, _first_two(after)])
    excess_s = outside_neighbours_s(every)[len(first) : len(first) + len(part.runs)]
    bad = excess_s > sensors.maximum_backwards_s[part.runs["sensor"]]
    if not bad.any():
        return part
    kept = part.stars[~bad[part.stars["run"]]]
    kept["run"] = (np.cumsum(~bad) - 1)[kept["run"]]
    refused = _rejections(part, bad, excess_s, sensors)
    return Validated(part.block, part.runs[~bad], kept, [*part.rejected, *refused])


def outside_neighbours_s(runs: Any) -> Floats:
    """Return (n,) by how much each run's time lies outside those of its neighbours, else 0.

    ``runs`` are RUN records in the order of the source; a neighbour is of the same sensor.
    """
    excess = np.zeros(len(runs))
    order = np.argsort(runs["sensor"], kind="stable")
    sensor, number, t = (runs[name][order] for name in ("sensor", "frame_id", "t_tai_ns"))
    rises = (np.diff(sensor) == 0) & (np.diff(number) > 0)
    agree = rises[1:] & rises[:-1] & (t[2:] >= t[:-2])
    back_ns, ahead_ns = t[:-2] - t[1:-1], t[1:-1] - t[2:]
    # Behind the next one, but not behind the one after: then the next one went back.
    ahead_ns[:-1][rises[2:] & (t[1:-2] <= t[3:])] = 0
    excess[order[1:-1]] = np.where(agree, np.maximum(np.maximum(back_ns, ahead_ns), 0), 0) / _NS
    return excess


def excess_of(record: Rejection) -> float:
    """Return the seconds that a refused frame's time was found outside its neighbours'.

    Its neighbours are gone when the record is tried again, so the measure is in its text.
    """
    return float(record.detail.partition(" s ")[0])


def _rejections(
    part: Validated, bad: Bools, excess_s: Floats, sensors: Sensors
) -> Iterator[Rejection]:
    block, known = part.block, Counter[int]()
    for record in part.rejected:
        known[record.row] += record.rows
    for k in np.flatnonzero(bad).tolist():
        run = part.runs[k]
        sensor = int(run["sensor"])
        detail = (
            f"{excess_s[k]:.6f} s outside the times of the frames before and after it, which "
            f"agree; limit {sensors.maximum_backwards_s[sensor]:g} s"
        )
        start = int(np.searchsorted(block.row, run["row"]))
        stop = int(np.searchsorted(block.run, block.run[start], side="right"))
        lines, first, count = np.unique(
            block.row[start:stop], return_index=True, return_counts=True
        )
        for line, i, rows in zip(lines.tolist(), first + start, count.tolist(), strict=True):
            if rows > known[line]:
                yield Rejection(
                    line,
                    TIME_BACKWARDS,
                    detail,
                    block.raw(int(i)),
                    int(block.offset[i]),
                    rows - known[line],
                    sensors.names[sensor],
                    str(run["frame_id"]),
                )
