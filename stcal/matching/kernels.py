"""Identification of a whole batch of exposures, one after the other (numba)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stcal.catalog.apparent_kernels import apparent_place
from stcal.jit import kernel
from stcal.matching.seed_kernels import (
    NO_MATCH,
    SOLVED,
    TOO_FEW_STARS,
    solve_guided,
    solve_lost_in_space,
)
from stcal.matching.verify_kernels import rotate


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
    shortest_arc: float
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


@kernel
def identify(
    offsets,
    s_d,
    intensity,
    observers,
    hints,
    guided,
    sky,
    rule,
    work,
    star,
    s_i,
    residual,
    c_di,
    status,
):
    """Identify the exposures of a batch; the last five arguments are filled.

    offsets (E + 1,); s_d (S, 3); intensity (S,), NaN where unknown; observers (F, 10); hints
    (E, 3, 3), NaN where there is none.  ``guided``: start from the hint, or from the first
    exposure's solution for the second of a frame, before identifying lost in space.
    """
    hint = np.empty((3, 3))
    order = np.empty(work.distance2.shape[0], np.int64)
    for e in range(offsets.shape[0] - 1):
        first, last = offsets[e], offsets[e + 1]
        mine = star[first:last]
        mine[:] = -1
        s_i[first:last] = np.nan
        residual[first:last] = np.nan
        c_di[e, :, :] = np.nan
        if last - first < rule.minimum_matches:
            status[e] = TOO_FEW_STARS
            continue
        exposure, ranks, observer = s_d[first:last], order[: last - first], observers[e // 2]
        brightest_first(intensity[first:last], ranks)
        found, c = 0, np.empty((3, 3))
        if guided:
            hint[:, :] = hints[e]
            if np.isnan(hint[0, 0]) and e % 2 == 1:
                hint[:, :] = c_di[e - 1]
            if not np.isnan(hint[0, 0]):
                found = solve_guided(exposure, ranks, hint, observer, sky, rule, work, mine, c)
        if found == 0:
            found = solve_lost_in_space(exposure, ranks, observer, sky, rule, work, mine, c)
        status[e] = SOLVED if found > 0 else NO_MATCH
        if found > 0:
            c_di[e, :, :] = c
            _describe(exposure, c, observer, sky, mine, s_i[first:last], residual[first:last])


@kernel
def brightest_first(intensity, order):
    """Fill ``order`` with the detections from bright to faint, unknown ones last; stable."""
    for k in range(intensity.shape[0]):
        place = k
        while place > 0 and (
            intensity[k] > intensity[order[place - 1]]
            or (np.isnan(intensity[order[place - 1]]) and not np.isnan(intensity[k]))
        ):
            order[place] = order[place - 1]
            place -= 1
        order[place] = k


@kernel
def _describe(s, c, observer, sky, star, s_i, residual):
    """Fill the apparent places of the matched stars and their departures from the attitude."""
    b = np.empty(3)
    for k in range(s.shape[0]):
        found = star[k]
        if found >= 0:
            apparent_place(
                sky.direction[found], sky.motion[found], sky.parallax[found], observer, s_i[k]
            )
            rotate(c, s_i[k], b)
            residual[k] = math.sqrt(
                (b[0] - s[k, 0]) ** 2 + (b[1] - s[k, 1]) ** 2 + (b[2] - s[k, 2]) ** 2
            )
