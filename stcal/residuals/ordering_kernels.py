"""Which pairs of stars an exposure's arcs are: the order of its stars (numba).

Enright 2018 section II-B: arcs run from each star to the next two, in an order in which no three in
sequence are collinear.
"""

from __future__ import annotations

import numpy as np

from stcal.jit import kernel

# A triple with a smallest angle below this (sine) makes its arcs nearly dependent.
_FLAT = 0.2


@kernel
def count_pairs(offsets):
    """Return how many pairs the exposures have, 2 N - 3 each."""
    count = 0
    for x in range(offsets.shape[0] - 1):
        count += max(2 * (offsets[x + 1] - offsets[x]) - 3, 0)
    return count


@kernel
def flatness2(ax, ay, az, bx, by, bz, cx, cy, cz):
    """Square of the sine of a triangle's smallest angle: 0 for collinear stars, and for needles.

    Components and not vectors, so that loops over triangles become vector instructions.
    """
    volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    p = (ax - bx) * (ax - bx) + (ay - by) * (ay - by) + (az - bz) * (az - bz)
    q = (bx - cx) * (bx - cx) + (by - cy) * (by - cy) + (bz - cz) * (bz - cz)
    r = (ax - cx) * (ax - cx) + (ay - cy) * (ay - cy) + (az - cz) * (az - cz)
    shortest = min(p, q, r)
    return volume * volume * shortest / (p * q * r) if shortest > 0.0 else 0.0


@kernel
def _flatness_in_sequence(s, k):
    """Return the flatness of stars k, k + 1 and k + 2 of s (3, N)."""
    return flatness2(
        s[0, k], s[1, k], s[2, k], s[0, k + 1], s[1, k + 1], s[2, k + 1],
        s[0, k + 2], s[1, k + 2], s[2, k + 2],
    )  # fmt: skip


@kernel
def _swap(s, order, i, j):
    order[i], order[j] = order[j], order[i]
    for a in range(3):
        s[a, i], s[a, j] = s[a, j], s[a, i]


@kernel
def _greedy(s, order, flat):
    """Let the next star always be the one that makes the least flat triple."""
    for k in range(2, order.shape[0] - 1):
        ax, ay, az = s[0, k - 2], s[1, k - 2], s[2, k - 2]
        bx, by, bz = s[0, k - 1], s[1, k - 1], s[2, k - 1]
        x, y, z = s[0, k:], s[1, k:], s[2, k:]
        pick = 0
        for j in range(x.shape[0]):
            flat[j] = flatness2(ax, ay, az, bx, by, bz, x[j], y[j], z[j])
        for j in range(x.shape[0]):
            if flat[j] > flat[pick]:
                pick = j
        _swap(s, order, k, k + pick)


@kernel
def _flattest_without(flat, i, j):
    """Return the first star of the flattest triple that has no star i and no star j, or -1."""
    where = -1
    for k in range(flat.shape[0]):
        if not (i - 2 <= k <= i or j - 2 <= k <= j) and (where < 0 or flat[k] < flat[where]):
            where = k
    return where


@kernel
def _least_with(s, triples, i, j, floor):
    """Return the least flatness of triples with star i or star j; any below ``floor`` will do."""
    least = 2.0
    for a in (i, j):
        for k in range(max(a - 2, 0), min(a + 1, triples)):
            least = min(least, _flatness_in_sequence(s, k))
            if least <= floor:
                return least
    return least


@kernel
def _best_swap(s, order, flat, where):
    """Return the swap of a star of triple ``where`` that leaves the least flat order, or -1, -1."""
    better, at, other = flat[where], -1, -1
    for i in range(where, where + 3):
        rest = _flattest_without(flat, i, i)
        for j in range(order.shape[0]):
            # A triple that stays would be as flat.
            if rest >= 0 and flat[rest] <= better and not j - 2 <= rest <= j:
                continue
            _swap(s, order, i, j)
            now = _least_with(s, flat.shape[0], i, j, better)
            _swap(s, order, i, j)
            if now > better:
                stays = _flattest_without(flat, i, j)
                now = min(now, flat[stays]) if stays >= 0 else now
                if now > better:
                    better, at, other = now, i, j
    return at, other


@kernel
def _mend(s, order, flat):
    """Swap stars until no triple is flat, or no swap helps."""
    for _ in range(order.shape[0]):
        where = 0
        for k in range(flat.shape[0]):
            flat[k] = _flatness_in_sequence(s, k)
            if flat[k] < flat[where]:
                where = k
        if flat[where] >= _FLAT * _FLAT:
            return
        i, j = _best_swap(s, order, flat, where)
        if i < 0:
            return
        _swap(s, order, i, j)


@kernel
def order_stars(offsets, s_i, order):
    """Order the stars of each exposure so that no three in sequence are collinear.

    ``order`` (K,) is filled with indices into s_i (K, 3).
    """
    for x in range(offsets.shape[0] - 1):
        first, last = offsets[x], offsets[x + 1]
        n = last - first
        local, s, flat = np.arange(n), np.empty((3, n)), np.empty(n)
        for k in range(n):
            for a in range(3):
                s[a, k] = s_i[first + k, a]
        _greedy(s, local, flat)
        if n >= 3:
            _mend(s, local, flat[: n - 2])
        order[first:last] = first + local
