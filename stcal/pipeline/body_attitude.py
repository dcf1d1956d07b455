"""The body's attitude over time: from another sensor of the store, or read from elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stcal.frames import FrameBatch

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_NS = 1e9


@dataclass(frozen=True)
class BodyAttitudes:
    """Attitudes of B relative to I.

    Attributes
    ----------
    t_tai_ns : (T,) int64, rising
    q_bi : (T, 4) scalar last, ``Rotation.from_quat(q_bi).apply(v_b) == v_i``
    covariance : (T, 3, 3) rad^2, of the small rotation error about the axes of B
    source : where they come from, for documents
    """

    t_tai_ns: Ints
    q_bi: Floats
    covariance: Floats
    source: dict[str, Any]


def attitudes_at(
    body: BodyAttitudes, t_tai_ns: Ints, maximum_gap_s: float
) -> tuple[Floats, Floats]:
    """Return c_bi (F, 3, 3) and its covariance (F, 3, 3) at times, NaN where there is none.

    A time between two attitudes at most ``maximum_gap_s`` apart has the one on the great circle
    between them; a time of the record itself has its attitude whatever the gap.
    """
    c_bi, covariance = (np.full((len(t_tai_ns), 3, 3), np.nan) for _ in range(2))
    inside, a, b = _neighbours(body.t_tai_ns, t_tai_ns, maximum_gap_s)
    if len(a):
        gap = np.maximum(body.t_tai_ns[b] - body.t_tai_ns[a], 1)
        share = (t_tai_ns[inside] - body.t_tai_ns[a]) / gap
        c_bi[inside] = _between(body.q_bi[a], body.q_bi[b], share)
        # Neighbours are taken to err alike, as those of an on-board filter do: the mean of
        # independent errors would be smaller.
        weight = share[:, None, None]
        covariance[inside] = (1.0 - weight) * body.covariance[a] + weight * body.covariance[b]
    return c_bi, covariance


def _neighbours(record: Ints, times: Ints, maximum_gap_s: float) -> tuple[Bools, Ints, Ints]:
    """Return which times lie inside the record (F,), and of those the attitudes on either side."""
    before = np.searchsorted(record, times, side="right") - 1
    after = np.searchsorted(record, times, side="left")
    found = np.flatnonzero((before >= 0) & (after < len(record)))
    # At a time of the record both are the same attitude.
    a, b = before[found], np.maximum(before[found], after[found])
    near = record[b] - record[a] <= maximum_gap_s * _NS
    inside = np.zeros(len(times), dtype=np.bool_)
    inside[found[near]] = True
    return inside, a[near], b[near]


def _between(q_a: Floats, q_b: Floats, share: Floats) -> Floats:
    """Return c_bi (K, 3, 3) at a share of the turn from one attitude to the next."""
    first, second = Rotation.from_quat(q_a), Rotation.from_quat(q_b)
    turn = (first.inv() * second).as_rotvec()
    c_ib = (first * Rotation.from_rotvec(share[:, None] * turn)).as_matrix()
    return np.asarray(np.swapaxes(c_ib, 1, 2))


def telemetered_attitudes(batches: Sequence[FrameBatch], source: dict[str, Any]) -> BodyAttitudes:
    """Return the quaternions that another sensor reported for its exposure 0, noise unknown."""
    chosen = [b.has_fix & (b.best_exposure == 0) for b in batches]
    times = np.concatenate([b.t_tai_ns[k] for b, k in zip(batches, chosen, strict=True)])
    q_bi = np.concatenate([b.q_si[k] for b, k in zip(batches, chosen, strict=True)])
    return BodyAttitudes(times, q_bi, np.zeros((len(times), 3, 3)), source)
