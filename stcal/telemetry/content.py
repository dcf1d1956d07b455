"""The content of a frame as bytes: what makes two versions of a frame equal, and its hash."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from stcal.constants import EXPOSURES_PER_FRAME
from stcal.frames import Floats, FrameBatch, Ints
from stcal.times import utc_day

Bytes = NDArray[np.uint8]


def content_bytes(frames: FrameBatch) -> tuple[Bytes, Bytes]:
    """Return the frames (F, k) and their stars (S, l) as bytes that depend on values only."""
    n = frames.n_frames
    numbers = np.column_stack(
        [frames.q_si, frames.rate_deg_s, frames.temperature_c, frames.pos_km, frames.vel_km_s]
    )
    counts = frames.stars_per_exposure.reshape(n, EXPOSURES_PER_FRAME)
    best = frames.best_exposure.astype(np.int64)
    whole = np.column_stack(
        [frames.frame_id, frames.t_tai_ns, best, frames.eclipse, frames.intrusion, counts]
    ).astype(np.int64)
    star_numbers = np.column_stack([frames.row_px, frames.col_px, frames.intensity])
    frame_bytes = np.hstack([_bytes_of(whole), _bytes_of(_canonical(numbers))])
    star_bytes = np.hstack(
        [_bytes_of(_canonical(star_numbers)), _bytes_of(frames.star_id.reshape(-1, 1))]
    )
    return frame_bytes, star_bytes


def _canonical(values: Floats) -> Floats:
    """One bit pattern for NaN and for zero."""
    return np.where(np.isnan(values), np.nan, values + 0.0)


def _bytes_of(values: Floats | Ints) -> Bytes:
    little = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
    return little.view(np.uint8).reshape(len(values), little.shape[1] * little.itemsize)


def frame_digests(frames: FrameBatch) -> list[str]:
    """Return the SHA-256 of every frame's content (F,), the sensor's name included."""
    frame_bytes, star_bytes = content_bytes(frames)
    seed = hashlib.sha256(frames.sensor_id.encode() + b"\0")
    first = frames.star_offsets[:-1:EXPOSURES_PER_FRAME].tolist()
    last = frames.star_offsets[EXPOSURES_PER_FRAME::EXPOSURES_PER_FRAME].tolist()
    digests = []
    for i, (start, stop) in enumerate(zip(first, last, strict=True)):
        digest = seed.copy()
        digest.update(frame_bytes[i])
        digest.update(star_bytes[start:stop].tobytes())
        digests.append(digest.hexdigest())
    return digests


def content_sha256(sensor_id: str, batches: Iterable[FrameBatch]) -> str:
    """Return the content hash of one sensor's frames in time order, however they are cut."""
    return combined_sha256(sensor_id, day_digests(batches))


def day_digests(batches: Iterable[FrameBatch]) -> dict[str, str]:
    """Return the hash of the frames of each UTC day, in time order.

    Days are hashed apart, so that several may be at the same time.
    """
    found: dict[str, str] = {}
    day, frame_hash, star_hash = "", hashlib.sha256(), hashlib.sha256()
    for batch in batches:
        for name, frames in _by_day(batch):
            if name != day:
                day, frame_hash, star_hash = name, hashlib.sha256(), hashlib.sha256()
            frame_bytes, star_bytes = content_bytes(frames)
            frame_hash.update(frame_bytes.tobytes())
            star_hash.update(star_bytes.tobytes())
            both = frame_hash.digest() + star_hash.digest()
            found[day] = hashlib.sha256(both).hexdigest()
    return found


def combined_sha256(sensor_id: str, digests: Mapping[str, str]) -> str:
    """Return the content hash of one sensor's frames from those of its days."""
    content = hashlib.sha256(sensor_id.encode() + b"\0")
    for day in sorted(digests):
        content.update(f"{day} {digests[day]}\n".encode())
    return content.hexdigest()


def _by_day(frames: FrameBatch) -> Iterator[tuple[str, FrameBatch]]:
    day = utc_day(frames.t_tai_ns)
    edges = [0, *(np.flatnonzero(np.diff(day)) + 1).tolist(), len(day)]
    for first, stop in pairwise(edges):
        if stop > first:
            part = frames if len(edges) == 2 else frames.take(np.arange(first, stop))
            yield str(day[first]), part
