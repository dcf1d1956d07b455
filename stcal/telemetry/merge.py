"""Merge incoming frames into a stored day, so that the order of ingestion leaves no trace.

Frames with equal sensor, frame_id and time are versions of one frame.  The version with more stars
is kept, then the one with the smaller content hash; equal versions are one, and keep the smallest
(source hash, row, name).  Both rules pick a least element, so the merge is associative, commutative
and idempotent: any order, any repetition and any interruption end in the same store.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from stcal.constants import EXPOSURES_PER_FRAME
from stcal.frames import FrameBatch, Ints
from stcal.telemetry.content import frame_digests
from stcal.telemetry.quarantine import LostVersion
from stcal.telemetry.schema import StoredFrames, join
from stcal.telemetry.writer import frame_json


class Outcome(IntEnum):
    """What became of an incoming frame."""

    NEW = 0
    DUPLICATE = 1
    # Kept in place of a version that the store had.
    REPLACED = 2
    # Lost against another version: in quarantine.
    CONFLICT = 3


@dataclass(frozen=True)
class Merge:
    """The merged day.

    Attributes
    ----------
    kept : the day's frames, ordered by (t_tai_ns, frame_id)
    lost : the displaced versions
    outcome : (F,) :class:`Outcome` of every incoming frame
    """

    kept: StoredFrames
    lost: list[LostVersion]
    outcome: NDArray[np.int8]


def merge(stored: StoredFrames | None, lost: list[LostVersion], incoming: StoredFrames) -> Merge:
    """Merge incoming frames of one sensor and day into what the store has of it."""
    n_stored = 0 if stored is None else stored.frames.n_frames
    every = incoming if stored is None else join([stored, incoming])
    order = np.lexsort((every.frames.frame_id, every.frames.t_tai_ns))
    keep = np.ones(len(order), dtype=np.bool_)
    outcome = np.full(len(order), Outcome.NEW, dtype=np.int8)
    versions = {(version.frame_id, version.content_sha256): version for version in lost}
    contested = _contested(every.frames, order)
    if contested:
        contest = _Contest(every, contested)
        for members in contested:
            contest.settle(members, n_stored, keep, outcome, versions)
        every = contest.frames
    return Merge(every.take(order[keep[order]]), list(versions.values()), outcome[n_stored:])


def _contested(frames: FrameBatch, order: Ints) -> list[list[int]]:
    """Return the groups of frames that have one key, in stored-first order."""
    frame_id, time = frames.frame_id[order], frames.t_tai_ns[order]
    differs = (np.diff(frame_id) != 0) | (np.diff(time) != 0)
    group = np.concatenate(([0], np.cumsum(differs))) if len(order) else order
    shared = order[np.bincount(group)[group] > 1] if len(order) else order
    if not len(shared):
        return []
    boundaries = np.flatnonzero(np.diff(group[np.bincount(group)[group] > 1])) + 1
    return [part.tolist() for part in np.split(shared, boundaries)]


class _Contest:
    """The frames whose key occurs more than once, with their hashes and sources."""

    def __init__(self, every: StoredFrames, contested: list[list[int]]) -> None:
        flat = [index for members in contested for index in members]
        digests = frame_digests(every.frames.take(np.array(flat)))
        self._digest = dict(zip(flat, digests, strict=True))
        self._stars = np.diff(every.frames.star_offsets[::EXPOSURES_PER_FRAME])
        # Sources of equal versions are merged, so these columns change: not the caller's.
        self.frames = StoredFrames(
            every.frames,
            every.source.copy(),
            every.source_sha256.copy(),
            every.source_row.copy(),
        )

    def settle(
        self,
        members: list[int],
        n_stored: int,
        keep: NDArray[np.bool_],
        outcome: NDArray[np.int8],
        lost: dict[tuple[int, str], LostVersion],
    ) -> None:
        """Choose the version to keep among ``members``; ``lexsort`` is stable: stored first."""
        versions: dict[str, list[int]] = {}
        for index in members:
            versions.setdefault(self._digest[index], []).append(index)
        winner = min(versions, key=lambda digest: (-self._stars[versions[digest][0]], digest))
        from_store = any(index < n_stored for index in members)
        keep[members] = False
        for digest, equal in versions.items():
            source = min(self._source(index) for index in equal)
            if digest == winner:
                keep[equal[0]] = True
                self._set_source(equal[0], source)
                outcome[equal] = Outcome.DUPLICATE
                outcome[equal[0]] = Outcome.REPLACED if from_store else Outcome.NEW
                lost.pop((int(self.frames.frames.frame_id[equal[0]]), digest), None)
            else:
                outcome[equal] = Outcome.CONFLICT
                self._record(equal[0], digest, source, lost)

    def _source(self, index: int) -> tuple[str, int, str]:
        frames = self.frames
        return (
            str(frames.source_sha256[index]),
            int(frames.source_row[index]),
            str(frames.source[index]),
        )

    def _set_source(self, index: int, source: tuple[str, int, str]) -> None:
        frames = self.frames
        frames.source_sha256[index], frames.source_row[index], frames.source[index] = source

    def _record(
        self,
        index: int,
        digest: str,
        source: tuple[str, int, str],
        lost: dict[tuple[int, str], LostVersion],
    ) -> None:
        frames = self.frames.frames
        key = (int(frames.frame_id[index]), digest)
        known = lost.get(key)
        if known is not None:
            source = min(source, (known.source_sha256, known.row, known.source))
        sha256, row, name = source
        lost[key] = LostVersion(
            source=name,
            source_sha256=sha256,
            row=row,
            rows=max(1, int(self._stars[index])),
            sensor_id=frames.sensor_id,
            frame_id=key[0],
            raw=frame_json(frames, index).encode(),
            content_sha256=digest,
        )
