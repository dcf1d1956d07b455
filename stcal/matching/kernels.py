"""Identification of a whole batch of exposures, one after the other (numba)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stcal.matching.seed_kernels import (
    BY_HINT,
    BY_NOTHING,
    BY_TRIAD,
    NO_MATCH,
    SOLVED,
    TOO_FEW_STARS,
    solve_guided,
    solve_lost_in_space,
)


class Sky(NamedTuple):
    """The sky index as the kernels see it."""

    direction: NDArray[np.float64]
    motion: NDArray[np.float64]
    parallax: NDArray[np.float64]
    epoch_direction: NDArray[np.float64]
    pair_angle: NDArray[np.float32]
    pair_a: NDArray[np.int32]
    pair_b: NDArray[np.int32]
    pair_start: NDArray[np.int32]
    pair_bin: float
    pair_limit: float
    cell_start: NDArray[np.int32]
    cell_star: NDArray[np.int32]
    cells: int
    radius: float


class Rule(NamedTuple):
    """Tolerances [rad] and the acceptance rule."""

    pair_tolerance: float
    star_tolerance: float
    hint_radius: float
    minimum_matches: int
    seed_stars: int
    hypotheses: float
    chance: float
    false_alarm: float


class Work(NamedTuple):
    """Scratch arrays, made once for a batch."""

    head: NDArray[np.int32]
    owner: NDArray[np.int32]
    following: NDArray[np.int32]
    partner: NDArray[np.int32]
    target: NDArray[np.float64]
    distance2: NDArray[np.float64]
    triads: NDArray[np.int32]
    cost: NDArray[np.float64]


def make_work(catalogue_stars: int, largest_exposure: int, pairs: int, seeds: int) -> Work:
    """Allocate scratch for exposures of at most ``largest_exposure`` detections."""
    triads = max(1, seeds * (seeds - 1) * (seeds - 2) // 6)
    return Work(
        head=np.full(catalogue_stars, -1, np.int32),
        owner=np.full(catalogue_stars, -1, np.int32),
        following=np.empty(2 * pairs, np.int32),
        partner=np.empty(2 * pairs, np.int32),
        target=np.empty((largest_exposure, 3)),
        distance2=np.empty(largest_exposure),
        triads=np.empty((triads, 3), np.int32),
        cost=np.empty(triads),
    )


@njit(cache=True, nogil=True)
def identify(
    offsets, s_d, order, observers, hints, guided, lost, sky, rule, work, star, c_di, status, method
):
    """Identify the exposures of a batch; the last four arguments are filled.

    offsets (E + 1,); s_d (S, 3); order (S,) brightest first within each exposure; observers
    (F, 10); hints (E, 3, 3), NaN where there is none.  ``guided``: start from the hint, or from
    the first exposure's solution for the second of a frame.  ``lost``: identify lost in space
    what no hint has solved.
    """
    hint = np.empty((3, 3))
    for e in range(offsets.shape[0] - 1):
        first, last = offsets[e], offsets[e + 1]
        mine = star[first:last]
        mine[:] = -1
        c_di[e, :, :] = np.nan
        method[e] = BY_NOTHING
        if last - first < rule.minimum_matches:
            status[e] = TOO_FEW_STARS
            continue
        exposure, ranks, observer = s_d[first:last], order[first:last], observers[e // 2]
        found, c = 0, np.empty((3, 3))
        if guided:
            hint[:, :] = hints[e]
            if np.isnan(hint[0, 0]) and e % 2 == 1:
                hint[:, :] = c_di[e - 1]
            if not np.isnan(hint[0, 0]):
                found = solve_guided(exposure, ranks, hint, observer, sky, rule, work, mine, c)
                method[e] = BY_HINT
        if found == 0 and lost:
            found = solve_lost_in_space(exposure, ranks, observer, sky, rule, work, mine, c)
            method[e] = BY_TRIAD
        if found == 0:
            method[e] = BY_NOTHING
            status[e] = NO_MATCH
        else:
            status[e] = SOLVED
            c_di[e, :, :] = c
