"""Attitudes from pairs of stars, and guided identification of one exposure by them (numba)."""

from __future__ import annotations

import math

import numpy as np

from stcal.catalog.apparent_kernels import geometric_from_apparent
from stcal.jit import kernel
from stcal.matching.settle_kernels import settle
from stcal.matching.verify_kernels import (
    cell_of,
    copy_rows,
    distance2,
    rotated_back,
)

# Catalogue stars that a detection may stand for.
_CANDIDATES = 64


@kernel
def separation(a, b):
    """Angle between unit vectors [rad], exact for short arcs too."""
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(x * x + y * y + z * z)))


@kernel
def _normal(a, b):
    """Return the unit normal of two directions, zero where they are the same."""
    x = a[1] * b[2] - a[2] * b[1]
    y = a[2] * b[0] - a[0] * b[2]
    z = a[0] * b[1] - a[1] * b[0]
    norm = math.sqrt(x * x + y * y + z * z)
    if norm < 1e-9:
        return 0.0, 0.0, 0.0
    return x / norm, y / norm, z / norm


@kernel
def two_vector_attitude(s1, s2, u1, u2, c):
    """TRIAD: the rotation c with c u1 = s1 and c u2 in the plane of s1, s2 (Black 1964).

    Returns False where two directions are the same.
    """
    n, m = _normal(s1, s2), _normal(u1, u2)
    # The third axes complete the right-handed triads.
    p = s1[1] * n[2] - s1[2] * n[1], s1[2] * n[0] - s1[0] * n[2], s1[0] * n[1] - s1[1] * n[0]
    q = u1[1] * m[2] - u1[2] * m[1], u1[2] * m[0] - u1[0] * m[2], u1[0] * m[1] - u1[1] * m[0]
    for i in range(3):
        for j in range(3):
            c[i, j] = s1[i] * u1[j] + n[i] * m[j] + p[i] * q[j]
    return n != (0.0, 0.0, 0.0) and m != (0.0, 0.0, 0.0)


@kernel
def _candidates(s, k, hint, radius, observer, stars, out):
    """List catalogue stars within ``radius`` of a detection under the hint; returns how many."""
    x, y, z = rotated_back(hint, s[k, 0], s[k, 1], s[k, 2])
    x, y, z = geometric_from_apparent(x, y, z, observer)
    cell = cell_of(x, y, z, stars.cells)
    count = 0
    for e in range(stars.cell_start[cell], stars.cell_start[cell + 1]):
        d2 = distance2(x, y, z, stars.direction, stars.cell_star[e])
        if d2 < radius * radius and count < out.shape[0]:
            out[count] = stars.cell_star[e]
            count += 1
    return count


@kernel
def search_near(s, order, hint, observer, stars, rule, slots, star, c, best):
    """Identify one exposure within the hint radius of ``hint``; returns the number of matches.

    Pairs of bright stars whose catalogue candidates lie within the hint radius and whose arclength
    agrees are tried until more than half of the stars match.  ``best`` matches in ``star`` with the
    attitude ``c`` are what is known already.
    """
    u, target, count = stars.direction, slots.target, s.shape[0]
    best_c, kept, places = c.copy(), star.copy(), np.empty((count, 3))
    copy_rows(target, places, count)
    list1, list2 = np.empty(_CANDIDATES, np.int32), np.empty(_CANDIDATES, np.int32)
    enough = count // 2
    for x in range(order.shape[0]):
        i = order[x]
        n1 = _candidates(s, i, hint, rule.hint_radius, observer, stars, list1)
        for y in range(x + 1, order.shape[0] if best <= enough and n1 > 0 else 0):
            j = order[y]
            arc = separation(s[i], s[j])
            if best > enough or arc < rule.shortest_arc:
                continue
            n2 = _candidates(s, j, hint, rule.hint_radius, observer, stars, list2)
            for p in range(n1 * n2):
                a, b = u[list1[p // n2]], u[list2[p % n2]]
                if best > enough or abs(separation(a, b) - arc) > rule.pair_tolerance:
                    continue
                if two_vector_attitude(s[i], s[j], a, b, c):
                    found = settle(s, c, observer, stars, rule, slots, star)
                    if found > best:
                        best, kept[:] = found, star
                        copy_rows(c, best_c, 3)
                        copy_rows(target, places, count)
    copy_rows(best_c, c, 3)
    copy_rows(places, target, count)
    for k in range(count):
        star[k] = kept[k] if best > 0 else -1
        slots.placed[k] = star[k]
    return best
