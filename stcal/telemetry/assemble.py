"""Runs of rows to frames: pieces of one frame are joined, copies of it are told apart.

Runs that say the same about their frame are pieces of it (a file with reordered rows), copies of it
(overlapping downloads in one file), or both.  What decides is how often each star occurs:

- every star equally often, m times: m copies of one frame, in whatever pieces;
- otherwise, or when the joined pieces would hold half of their identifiers twice in an exposure
  (one may be a false match of the sensor's): the frame was given in versions that differ.  They
  are cut apart where a run begins, where a run's first row comes again, and where the exposure
  steps back, and compete as versions of a frame do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stcal.constants import EXPOSURES_PER_FRAME
from stcal.frames import Bools, FrameBatch, Ints
from stcal.telemetry.columns import FRAME_NUMBERS, VECTORS

_STAR_KEYS = ("exposure", "row_px", "col_px", "intensity", "star_id")


@dataclass(frozen=True)
class Assembled:
    """Frames of several sensors.

    Attributes
    ----------
    frames : the frames of every sensor in one batch, which therefore names none
    sensor : (F,) index of the sensor
    row : (F,) the frame's first line in the file
    rows : (F,) rows that the frame was made of
    copies, copied_rows : (F,) further equal copies of the frame in the file, and their rows
    """

    frames: FrameBatch
    sensor: Ints
    row: Ints
    rows: Ints
    copies: Ints
    copied_rows: Ints

    def of_sensor(self, which: Ints, sensor_id: str) -> FrameBatch:
        """Return the frames ``which``, all of one sensor, under its name."""
        return replace(self.frames.take(which), sensor_id=sensor_id)


def assemble(runs: Any, stars: Any) -> Assembled:
    """Join RUN and STAR records of :mod:`stcal.telemetry.validate` to frames."""
    group = _group(runs)
    version = group[stars["run"]]
    parent = np.arange(int(group.max(initial=-1)) + 1)
    order, repeated = _sort(version, stars)
    odd = _odd_groups(group, version, stars, order, repeated)
    if len(odd):
        version, parent = _cut_apart(odd, parent, version, stars)
        order, repeated = _sort(version, stars)
    return _collect(runs, stars, group, parent, version, order[~repeated])


def _collect(
    runs: Any, stars: Any, group: Ints, parent: Ints, version: Ints, distinct: Ints
) -> Assembled:
    """Return the versions as frames: ``distinct`` lists their stars once each, in order."""
    n, n_groups = len(parent), int(group.max(initial=-1)) + 1
    exposure = EXPOSURES_PER_FRAME * version[distinct] + stars["exposure"][distinct]
    counts = np.bincount(exposure, minlength=EXPOSURES_PER_FRAME * n)
    total = np.bincount(version, minlength=n)
    once = counts.reshape(n, EXPOSURES_PER_FRAME).sum(axis=1)
    # Rows that hold no star: in a frame with stars they add nothing, else each is a copy of it.
    of_group = np.bincount(parent[version], minlength=n_groups)
    blank = np.zeros(n, dtype=np.int64)
    taken = np.bincount(group, runs["rows"], minlength=n_groups).astype(np.int64)
    blank[:n_groups] = taken - of_group
    starless = once == 0
    copied_rows = np.where(starless, np.maximum(blank - 1, 0), total - once)
    rows = total + blank - copied_rows
    copies = np.where(starless, copied_rows, total // np.maximum(once, 1) - 1)
    first_run = np.empty(n_groups, dtype=np.int64)
    latest_first = np.argsort(-runs["row"], kind="stable")
    first_run[group[latest_first]] = latest_first
    chosen = runs[first_run[parent]]
    row = np.where(starless, chosen["row"], np.iinfo(np.int64).max)
    np.minimum.at(row, version, stars["row"])
    offsets = np.concatenate(([0], np.cumsum(counts)))
    frames = _batch(chosen, offsets, stars[distinct])
    return Assembled(frames, chosen["sensor"], row, rows, copies, copied_rows)


def _batch(runs: Any, offsets: Ints, stars: Any) -> FrameBatch:
    numbers = runs["numbers"]
    vectors = {
        key: numbers[:, [FRAME_NUMBERS.index(name) for name in names]]
        for key, names in VECTORS.items()
    }
    scalars = ("frame_id", "t_tai_ns", "best_exposure", "eclipse", "intrusion")
    columns = {name: np.ascontiguousarray(runs[name]) for name in scalars}
    per_star = ("row_px", "col_px", "intensity", "star_id")
    columns |= {name: np.ascontiguousarray(stars[name]) for name in per_star}
    temperature_c = numbers[:, FRAME_NUMBERS.index("temperature_c")]
    return FrameBatch(
        sensor_id="", star_offsets=offsets, temperature_c=temperature_c, **columns, **vectors
    )


def _group(runs: Any) -> Ints:
    """Return the group of each run: equal frame-level values, unless the run stands alone."""
    key = _mix(runs)
    order = np.lexsort((runs["row"], key, runs["frame_id"], runs["t_tai_ns"], runs["sensor"]))
    sorted_runs, sorted_key = runs[order], key[order]
    new = np.ones(len(runs), dtype=np.bool_)
    new[1:] = sorted_runs["alone"][1:] | (sorted_key[1:] != sorted_key[:-1])
    for name in ("sensor", "t_tai_ns", "frame_id"):
        new[1:] |= sorted_runs[name][1:] != sorted_runs[name][:-1]
    group = np.empty(len(runs), dtype=np.int64)
    group[order] = np.cumsum(new) - 1
    return group


def _mix(runs: Any) -> Any:
    """Return a 64-bit number of the frame-level values, equal where they are equal."""
    numbers = np.ascontiguousarray(runs["numbers"])
    words = np.where(np.isnan(numbers), np.nan, numbers).view(np.uint64)
    scalars = [runs[name].astype(np.uint64) for name in ("best_exposure", "eclipse", "intrusion")]
    words = np.column_stack([words, *scalars])
    rng = np.random.default_rng(0)
    odd = rng.integers(0, 2**63, words.shape[1], dtype=np.uint64) * np.uint64(2) + np.uint64(1)
    mixed = (words ^ (words >> np.uint64(31))) * odd
    return (mixed ^ (mixed >> np.uint64(29))).sum(axis=1, dtype=np.uint64)


def _sort(version: Ints, stars: Any) -> tuple[Ints, Bools]:
    """Return the stars' order in the store, and which of the ordered repeat the one before."""
    keys = (
        version,
        stars["exposure"],
        -stars["intensity"],  # NaN comes last
        stars["row_px"],
        stars["col_px"],
        stars["star_id"],
        stars["row"],
    )
    order = _lexicographic_order(keys)
    ordered, of = stars[order], version[order]
    same = of[1:] == of[:-1]
    for name in _STAR_KEYS:
        same &= (ordered[name][1:] == ordered[name][:-1]) | _both_nan(ordered[name])
    return order, np.concatenate((np.zeros(min(1, len(order)), dtype=np.bool_), same))


def _lexicographic_order(keys: tuple[Any, ...]) -> Ints:
    """Return the order of rows by the first key, then the second and so on.

    Sources often have their stars in order but for a few exposures: only these are sorted then.
    """
    exposure = keys[:2]
    if _steps_back(exposure).any():
        return np.lexsort(keys[::-1])
    order = np.arange(len(keys[0]))
    changes = np.any([key[1:] != key[:-1] for key in exposure], axis=0)
    number = np.concatenate((np.zeros(min(1, len(order)), dtype=np.int64), np.cumsum(changes)))
    is_odd = np.zeros(len(order), dtype=np.bool_)
    is_odd[number[1:][_steps_back(keys)]] = True
    rows = np.flatnonzero(is_odd[number])
    order[rows] = rows[np.lexsort([key[rows] for key in keys[::-1]])]
    return order


def _steps_back(keys: tuple[Any, ...]) -> Bools:
    """Return (n - 1,) whether a row comes before the one in front of it; NaN counts as such."""
    tied = np.ones(max(len(keys[0]) - 1, 0), dtype=np.bool_)
    back = np.zeros_like(tied)
    for key in keys:
        back |= tied & ~(key[1:] >= key[:-1])
        tied &= key[1:] == key[:-1]
        if not tied.any():
            break
    return back


def _both_nan(values: Any) -> Bools:
    nan: Bools = np.isnan(values)
    return nan[1:] & nan[:-1]


def _odd_groups(group: Ints, version: Ints, stars: Any, order: Ints, repeated: Bools) -> Ints:
    """Return the groups whose runs are neither pieces nor equal copies of one frame."""
    n = int(group.max(initial=-1)) + 1
    distinct = np.cumsum(~repeated) - 1
    times = np.bincount(distinct)
    of_distinct = version[order][~repeated]
    most, least = np.zeros(n, dtype=np.int64), np.full(n, np.iinfo(np.int64).max)
    np.maximum.at(most, of_distinct, times)
    np.minimum.at(least, of_distinct, times)
    odd = most > np.minimum(least, np.maximum(most, 1))
    several_runs = np.bincount(group, minlength=n) > 1
    if several_runs.any():
        odd |= several_runs & _repeats_identifiers(n, version, stars, order[~repeated])
    return np.flatnonzero(odd)


def _repeats_identifiers(n: int, version: Ints, stars: Any, distinct: Ints) -> Bools:
    """Whether half of the identifiers in a group's distinct stars come twice in one exposure."""
    known = distinct[stars["star_id"][distinct] != 0]
    exposure = EXPOSURES_PER_FRAME * version[known] + stars["exposure"][known]
    identifier = stars["star_id"][known]
    order = np.lexsort((identifier, exposure))
    twice = (np.diff(exposure[order]) == 0) & (np.diff(identifier[order]) == 0)
    repeats = np.bincount(exposure[order][1:][twice] // EXPOSURES_PER_FRAME, minlength=n)
    identifiers = np.bincount(version[known], minlength=n) - repeats
    return (repeats > 0) & (2 * repeats >= identifiers)


def _cut_apart(odd: Ints, parent: Ints, version: Ints, stars: Any) -> tuple[Ints, Ints]:
    """Return the version of each star and the group of each version, odd groups cut apart."""
    version, parents = version.copy(), [parent]
    following = len(parent)
    by_group = np.argsort(version, kind="stable")
    edges = np.searchsorted(version[by_group], [odd, odd + 1])
    for g, start, stop in zip(odd.tolist(), *edges.tolist(), strict=True):
        members = by_group[start:stop]
        members = members[np.argsort(stars["row"][members], kind="stable")]
        cuts = _cuts(stars[members])
        # The first version keeps the group's number; the others follow after all groups.
        version[members] = np.where(cuts == 0, g, following + cuts - 1)
        parents.append(np.full(cuts[-1], g))
        following += int(cuts[-1])
    return version, np.concatenate(parents)


def _cuts(stars: Any) -> Ints:
    """Return the number of the version that each star belongs to, from 0; stars in file order."""
    keys = list(zip(*(np.nan_to_num(stars[name]).tolist() for name in _STAR_KEYS), strict=True))
    run, exposure = stars["run"].tolist(), stars["exposure"].tolist()
    number, first, numbers = 0, 0, []
    for i, key in enumerate(keys):
        begins = i > 0 and (
            run[i] != run[i - 1] or key == keys[first] or exposure[i] < exposure[i - 1]
        )
        if begins:
            number, first = number + 1, i
        numbers.append(number)
    return np.array(numbers, dtype=np.int64)
