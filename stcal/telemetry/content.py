"""The content of a frame as bytes: what makes two versions of a frame equal, and its hash."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from stcal.constants import EXPOSURES_PER_FRAME
from stcal.frames import Floats, FrameBatch, Ints

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


class ContentHash:
    """SHA-256 of a stream of frames, the same however the stream is cut into batches."""

    def __init__(self, sensor_id: str) -> None:
        """Start with no frames."""
        self._frames = hashlib.sha256(sensor_id.encode() + b"\0")
        self._stars = hashlib.sha256()

    def update(self, frames: FrameBatch) -> None:
        """Add the next frames."""
        frame_bytes, star_bytes = content_bytes(frames)
        self._frames.update(frame_bytes.tobytes())
        self._stars.update(star_bytes.tobytes())

    def hexdigest(self) -> str:
        """Return the hash of everything so far."""
        return hashlib.sha256(self._frames.digest() + self._stars.digest()).hexdigest()


def content_sha256(sensor_id: str, batches: Iterable[FrameBatch]) -> str:
    """Return the content hash of one sensor's frames in time order."""
    content = ContentHash(sensor_id)
    for batch in batches:
        content.update(batch)
    return content.hexdigest()
