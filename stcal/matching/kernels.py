"""Identification of a whole batch of exposures, one after the other (numba)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stcal.jit import kernel
from stcal.matching.seed_kernels import search_near
from stcal.matching.settle_kernels import departure2, settle
from stcal.matching.triad_kernels import solve_lost_in_space
from stcal.matching.verify_kernels import copy_rows

SOLVED, TOO_FEW_STARS, NO_MATCH = 0, 1, 2


# A call costs two atomic operations for each array in its arguments, so kernels are handed the
# part of these records that they need.


class StarMap(NamedTuple):
    """Stars and the map of the sky, see ``index.SkyIndex``."""

    star: NDArray[np.float64]
    direction: NDArray[np.float64]
    cell_start: NDArray[np.int32]
    cell_star: NDArray[np.int32]
    cells: int
    radius: float


class PairTable(NamedTuple):
    """Pairs of stars by separation."""

    angle: NDArray[np.float32]
    pair: NDArray[np.int32]
    start: NDArray[np.int32]
    bin: float
    limit: float


class Sky(NamedTuple):
    """The sky index as the kernels see it."""

    stars: StarMap
    pairs: PairTable


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


class Slots(NamedTuple):
    """Scratch of the check, one slot a detection but for ``owner``.

    ``target`` (N, 3) holds the apparent place of the star ``placed`` (N,); ``distance2`` (N,) is
    the squared departure from it, ``before`` (N,) the match of the round before; ``owner`` (C,) the
    detection that a catalogue star is matched to.
    """

    target: NDArray[np.float64]
    distance2: NDArray[np.float64]
    placed: NDArray[np.int32]
    before: NDArray[np.int32]
    owner: NDArray[np.int32]


class Join(NamedTuple):
    """Scratch of the join.

    ``head`` (C,) starts each star's chain of pairs, ``chain`` (2 P, 2) holds the next link and the
    star at the other end, ``joined`` (2 P, 2) the places in the pairs of the second window that
    meet a chain, with a link of it, ``triangles`` (2 P, 3) stars; triads (T, 3) of detections with
    their cost (T,).
    """

    head: NDArray[np.int32]
    chain: NDArray[np.int32]
    joined: NDArray[np.int32]
    triangles: NDArray[np.int32]
    triads: NDArray[np.int32]
    cost: NDArray[np.float64]


class Work(NamedTuple):
    """Scratch arrays, made once for a batch."""

    slots: Slots
    join: Join


def make_work(catalogue_stars: int, largest_exposure: int, pairs: int, seeds: int) -> Work:
    """Allocate scratch for exposures of at most ``largest_exposure`` detections."""
    triads = max(1, seeds * (seeds - 1) * (seeds - 2) // 6)
    return Work(
        Slots(
            target=np.empty((largest_exposure, 3)),
            distance2=np.empty(largest_exposure),
            placed=np.empty(largest_exposure, np.int32),
            before=np.empty(largest_exposure, np.int32),
            owner=np.full(catalogue_stars, -1, np.int32),
        ),
        Join(
            head=np.full(catalogue_stars, -1, np.int32),
            chain=np.empty((2 * pairs, 2), np.int32),
            joined=np.empty((2 * pairs + 1, 2), np.int32),
            triangles=np.empty((2 * pairs + 1, 3), np.int32),
            triads=np.empty((triads, 3), np.int32),
            cost=np.empty(triads),
        ),
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

    offsets (E + 1,); s_d (S, 3); intensity (S,), NaN where unknown; observers (F, 13); hints
    (E, 3, 3), NaN where there is none.  ``guided``: start from the hint, or from the first
    exposure's solution for the second of a frame, before identifying lost in space.
    """
    hint, c = np.empty((3, 3)), np.empty((3, 3))
    order = np.empty(rule.seed_stars, np.int64)
    for e in range(offsets.shape[0] - 1):
        first, last = offsets[e], offsets[e + 1]
        mine, count = star[first:last], last - first
        mine[:] = -1
        s_i[first:last] = np.nan
        residual[first:last] = np.nan
        c_di[e, :, :] = np.nan
        if count < rule.minimum_matches:
            status[e] = TOO_FEW_STARS
            continue
        exposure, observer = s_d[first:last], observers[e // 2]
        work.slots.placed[:count] = -1
        hinted, found = guided and _take_hint(e, hints, c_di, hint), 0
        if hinted:
            copy_rows(hint, c, 3)
            found = settle(exposure, c, observer, sky.stars, rule, work.slots, mine)
        if 2 * found <= count:
            bright = order[: min(count, rule.seed_stars)]
            brightest_first(intensity[first:last], bright)
            if hinted:
                found = search_near(
                    exposure, bright, hint, observer, sky.stars, rule, work.slots, mine, c, found
                )
            if found == 0:
                found = solve_lost_in_space(exposure, bright, observer, sky, rule, work, mine, c)
        status[e] = SOLVED if found > 0 else NO_MATCH
        if found > 0:
            copy_rows(c, c_di[e], 3)
            _describe(exposure, c, work.slots.target, mine, s_i[first:last], residual[first:last])


@kernel
def _take_hint(e, hints, c_di, hint):
    """Fill the hint of an exposure: its own, or the first exposure's solution for the second."""
    copy_rows(hints[e], hint, 3)
    if np.isnan(hint[0, 0]) and e % 2 == 1:
        copy_rows(c_di[e - 1], hint, 3)
    return not np.isnan(hint[0, 0])


@kernel
def brightest_first(intensity, order):
    """Fill ``order`` (M,) with the M brightest detections, unknown ones last; stable."""
    for k in range(intensity.shape[0]):
        place = min(k, order.shape[0])
        while place > 0 and (
            intensity[k] > intensity[order[place - 1]]
            or (np.isnan(intensity[order[place - 1]]) and not np.isnan(intensity[k]))
        ):
            if place < order.shape[0]:
                order[place] = order[place - 1]
            place -= 1
        if place < order.shape[0]:
            order[place] = k


@kernel
def _describe(s, c, target, star, s_i, residual):
    """Fill the apparent places of the matched stars and their departures from the attitude."""
    for k in range(s.shape[0]):
        if star[k] >= 0:
            s_i[k, 0], s_i[k, 1], s_i[k, 2] = target[k, 0], target[k, 1], target[k, 2]
            residual[k] = math.sqrt(departure2(s, c, target, k))
