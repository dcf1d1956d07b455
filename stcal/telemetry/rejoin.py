"""Refused rows that are good now, joined again with the rest of their frame.

A row of the long form that was refused for its star left the frame its other stars.  When it is
taken later, its frame is the one in the store (or among the displaced versions) with that star
added: what the file would have given, had the row been good at first.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stcal.constants import EXPOSURES_PER_FRAME
from stcal.frames import FrameBatch
from stcal.telemetry import jsonl
from stcal.telemetry.columns import FRAME_NUMBERS, VECTORS
from stcal.telemetry.quarantine import LostVersion
from stcal.telemetry.schema import StoredFrames
from stcal.telemetry.sensors import Sensors
from stcal.telemetry.sources import from_memory
from stcal.telemetry.store import Store
from stcal.telemetry.validate import RUN, STAR, validate
from stcal.times import utc_day

_SCALARS = ("frame_id", "t_tai_ns", "best_exposure", "eclipse", "intrusion")
_STAR = ("exposure", "row_px", "col_px", "intensity", "star_id")


def with_stored(
    runs: Any, stars: Any, store: Store, sensors: Sensors, plain: Sensors, sha256: str
) -> tuple[Any, Any]:
    """Return RUN and STAR records with the stars that the store has of the same frames.

    The version of a frame that came from the same source is the one taken; where an equal version
    of another source hides it, that one.

    Parameters
    ----------
    plain : the sensors with the first pixel's centre at 0, as displaced versions are written
    sha256 : of the source that the rows are from
    """
    open_runs = np.flatnonzero(~runs["alone"])
    days = utc_day(runs["t_tai_ns"]).astype(np.int64)
    known: dict[tuple[int, int], _Day] = {}
    runs, merged, added = runs.copy(), np.arange(len(runs)), []
    first: dict[bytes, int] = {}
    for k in open_runs.tolist():
        # Runs of one frame become one: its stars may have stood apart in the file.
        merged[k] = first.setdefault(_key(runs[k]), k)
        place = (int(runs[k]["sensor"]), int(days[k]))
        if merged[k] != k:
            runs[merged[k]]["rows"] += runs[k]["rows"]
            continue
        if place not in known:
            known[place] = _Day(store, sensors.names[place[0]], place[1], plain)
        whole = known[place].version(runs[k], sha256)
        if whole is not None:
            row, version = whole
            runs[k]["rows"] += len(version)
            version["run"], version["row"] = k, row if row >= 0 else runs[k]["row"]
            added.append(version)
            runs[k]["row"] = min(int(runs[k]["row"]), int(version["row"].min(initial=2**62)))
    stars = stars.copy()
    stars["run"] = merged[stars["run"]]
    if added:
        existing = np.concatenate(added)
        is_new = ~np.isin(_packed(stars), _packed(existing))
        stars = np.concatenate([stars[is_new], existing])
    kept = merged == np.arange(len(runs))
    stars["run"] = (np.cumsum(kept) - 1)[stars["run"]]
    return runs[kept], stars


class _Day:
    """What the store has of one sensor's day, by frame."""

    def __init__(self, store: Store, sensor_id: str, day: int, plain: Sensors) -> None:
        text = str(np.datetime64(day, "D"))
        self._stored = store.read_day(sensor_id, text)
        self._lost = store.read_lost(sensor_id, text)
        self._plain = plain
        frames = None if self._stored is None else self._stored.frames
        keys = (
            []
            if frames is None
            else zip(frames.frame_id.tolist(), frames.t_tai_ns.tolist(), strict=True)
        )
        self._place = {key: i for i, key in enumerate(keys)}

    def version(self, run: Any, sha256: str) -> tuple[int, Any] | None:
        """Return (first row, or -1 if it is another source's; STAR records) of a run's frame."""
        key = (int(run["frame_id"]), int(run["t_tai_ns"]))
        i = self._place.get(key)
        own = [v for v in self._lost if v.frame_id == key[0] and v.source_sha256 == sha256]
        if i is not None and self._stored is not None:
            is_own = self._stored.source_sha256[i] == sha256
            found = records_of_frame(self._stored, i)
            if _key(found[0]) == _key(run, sensor=0) and (is_own or not own):
                return (int(self._stored.source_row[i]) if is_own else -1), found[1]
        for version in own:
            lost = _records_of_lost(version, self._plain)
            if lost is not None and _key(lost[0], sensor=0) == _key(run, sensor=0):
                return version.row, lost[1]
        return None


def records_of_frame(stored: StoredFrames, i: int) -> tuple[Any, Any]:
    """Return a stored frame as a RUN record (of sensor 0) and its STAR records."""
    frames: FrameBatch = stored.frames.take(np.array([i]))
    run = np.zeros(1, RUN)
    for name in _SCALARS:
        run[name] = getattr(frames, name)
    for key, names in VECTORS.items():
        run["numbers"][:, [FRAME_NUMBERS.index(name) for name in names]] = getattr(frames, key)
    run["numbers"][:, FRAME_NUMBERS.index("temperature_c")] = frames.temperature_c
    stars = np.zeros(frames.n_stars, STAR)
    for name in _STAR[1:]:
        stars[name] = getattr(frames, name)
    stars["exposure"] = frames.exposure_of_star % EXPOSURES_PER_FRAME
    return run[0], stars


def _records_of_lost(version: LostVersion, plain: Sensors) -> tuple[Any, Any] | None:
    source = from_memory(version.source, version.source_sha256, version.raw)
    for block in jsonl.decode(source, lambda _: None):
        runs, stars, _ = validate(block, plain)
        if len(runs):
            return runs[0], stars
    return None


def _key(run: Any, sensor: int | None = None) -> bytes:
    """Return what makes two runs pieces of one frame: its sensor, number, time and values."""
    numbers = np.where(np.isnan(run["numbers"]), np.nan, run["numbers"] + 0.0)
    scalars = [int(run["sensor"]) if sensor is None else sensor]
    scalars += [int(run[name]) for name in _SCALARS]
    return np.array(scalars, dtype=np.int64).tobytes() + numbers.tobytes()


def _packed(stars: Any) -> Any:
    """Return (n,) one opaque value a star: its run and what the telemetry says of it."""
    numbers = np.column_stack([np.nan_to_num(stars[name], nan=-1e300) for name in _STAR[1:4]])
    words = np.column_stack([stars["run"], stars["exposure"], stars["star_id"]]).astype(np.int64)
    whole = np.ascontiguousarray(np.hstack([words, (numbers + 0.0).view(np.int64)]))
    return whole.view(np.dtype((np.void, 8 * whole.shape[1]))).ravel()
