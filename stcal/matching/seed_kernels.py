"""Lost-in-space and guided hypotheses, exposure by exposure (numba)."""

from __future__ import annotations

import math

import numpy as np

from stcal.catalog.apparent_kernels import geometric_from_apparent
from stcal.jit import kernel
from stcal.matching.settle_kernels import settle
from stcal.matching.verify_kernels import (
    best_rotation,
    cell_of,
    copy_rows,
    distance2,
    rotated_back,
)

# An exposure that its thirty best triads don't solve was not solved by 150 either.
_TRIALS = 30
_CHAIN = 64


@kernel
def separation(a, b):
    """Angle between unit vectors [rad], exact for short arcs too."""
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(x * x + y * y + z * z)))


@kernel
def _determinant(a, b, c):
    return (
        a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
    )


@kernel
def _window(low, high, pairs):
    """Return the range of the pair table with separations in [low, high]."""
    last_bin = pairs.start.shape[0] - 1
    i = pairs.start[min(max(int(low / pairs.bin), 0), last_bin)]
    n = pairs.angle.shape[0]
    while i < n and pairs.angle[i] < low:
        i += 1
    j = pairs.start[min(max(int(high / pairs.bin), 0), last_bin)]
    j = max(i, j)
    while j < n and pairs.angle[j] <= high:
        j += 1
    return i, j


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
def _measure_arcs(s, order):
    """Return the separations (M, M) of the brightest stars, in order of brightness."""
    arc = np.empty((order.shape[0], order.shape[0]))
    for x in range(order.shape[0]):
        for y in range(x + 1, order.shape[0]):
            arc[x, y] = arc[y, x] = separation(s[order[x]], s[order[y]])
    return arc


@kernel
def _list_triads(arc, limit, rule, join):
    """Fill all triads x < y < z of the brightest stars with their cost; returns how many.

    The cost stands for the size of the join that the triad asks for, infinite where an arc is too
    short or too long; the two shorter arcs are joined.  Written without branches.
    """
    count = 0
    for z in range(2, arc.shape[0]):
        for y in range(1, z):
            for x in range(y):
                a, b, c = arc[x, y], arc[x, z], arc[y, z]
                longest, shortest = max(a, max(b, c)), min(a, min(b, c))
                usable = (shortest >= rule.shortest_arc) & (longest <= limit)
                # Faint seeds are likelier false; rank costs like a wider window.
                cost = (a + b + c - longest) * (1.0 + 0.15 * (x + y + z))
                join.cost[count] = cost if usable else math.inf
                join.triads[count, 0], join.triads[count, 1], join.triads[count, 2] = x, y, z
                count += 1
    return count


@kernel
def _cheapest(cost, count):
    best = 0
    for t in range(1, count):
        if cost[t] < cost[best]:
            best = t
    return best


@kernel
def _from_pivot(x, y, z, arc):
    """Return a triad's stars with the pivot, from which the two shorter arcs go, first."""
    if arc[y, z] >= arc[x, y] and arc[y, z] >= arc[x, z]:
        return x, y, z
    if arc[x, z] >= arc[x, y]:
        return y, x, z
    return z, x, y


@kernel
def _chain_pairs(i0, i1, pair, join):
    """Chain the pairs of a window at both their stars."""
    head, chain = join.head, join.chain
    n = 0
    for p in range(i0, i1):
        for side in range(2):
            hub = pair[p, side]
            chain[n, 0], chain[n, 1] = head[hub], pair[p, 1 - side]
            head[hub] = n
            n += 1


@kernel
def _unchain_pairs(i0, i1, pair, head):
    for p in range(i0, i1):
        head[pair[p, 0]] = -1
        head[pair[p, 1]] = -1


@kernel
def _next_triangle(side, link, last, shape, u, pair, join):
    """Find the next catalogue triangle of the join; returns whether, and where to go on.

    ``side`` counts the stars of the second window's pairs, ``link`` is the place in that star's
    chain, -1 for its head.  Returns (found, side, link, hub, near, far).
    """
    head, chain = join.head, join.chain
    low2, high2, volume, flat = shape
    found, hub, near, far = False, 0, 0, 0
    while side < last and not found:
        hub, far = pair[side // 2, side % 2], pair[side // 2, 1 - side % 2]
        if link < 0:
            link = head[hub]
        while link >= 0 and not found:
            link, near = chain[link, 0], chain[link, 1]
            d2 = distance2(u[near, 0], u[near, 1], u[near, 2], u, far)
            if low2 <= d2 <= high2 and near != far:
                mirror = _determinant(u[hub], u[near], u[far])
                found = volume * mirror >= 0.0 or max(abs(volume), abs(mirror)) <= flat
        if link < 0:
            side += 1
    return found, side, link, hub, near, far


@kernel
def _triad_attitude(s, pivot, first, second, u, hub, near, far, c):
    """Fill the attitude of three matched stars; returns False where they don't fix one."""
    fixed = two_vector_attitude(s[second], s[first], u[far], u[near], c)
    # Least squares over the three stars, so that the look-up needs no wider radius.
    p00, p01, p02 = _sum_of_products(s, pivot, first, second, 0, u, hub, near, far)
    p10, p11, p12 = _sum_of_products(s, pivot, first, second, 1, u, hub, near, far)
    p20, p21, p22 = _sum_of_products(s, pivot, first, second, 2, u, hub, near, far)
    return fixed and best_rotation((p00, p01, p02, p10, p11, p12, p20, p21, p22), c)


@kernel
def _sum_of_products(s, i, j, k, axis, u, a, b, c):
    """Return a row of sum s u^T over three stars."""
    p, q, r = s[i, axis], s[j, axis], s[k, axis]
    return (
        p * u[a, 0] + q * u[b, 0] + r * u[c, 0],
        p * u[a, 1] + q * u[b, 1] + r * u[c, 1],
        p * u[a, 2] + q * u[b, 2] + r * u[c, 2],
    )


@kernel
def _try_triad(s, pivot, first, second, arcs, observer, sky, rule, work, star, c):
    """Join the two pair windows of a triad over the pivot; settle the first that passes."""
    tolerance, u, pair = rule.pair_tolerance, sky.stars.direction, sky.pairs.pair
    i0, i1 = _window(arcs[0] - tolerance, arcs[0] + tolerance, sky.pairs)
    j0, j1 = _window(arcs[1] - tolerance, arcs[1] + tolerance, sky.pairs)
    low = 2.0 * math.sin(0.5 * max(arcs[2] - tolerance, 0.0))
    high = 2.0 * math.sin(0.5 * (arcs[2] + tolerance))
    # Flatter than the tolerance, the handedness can't be told.
    flat = tolerance * max(arcs[0], arcs[1], arcs[2])
    shape = low * low, high * high, _determinant(s[pivot], s[first], s[second]), flat
    _chain_pairs(i0, i1, pair, work.join)
    matches, side, link, found = 0, 2 * j0, -1, True
    while found and matches == 0:
        found, side, link, hub, near, far = _next_triangle(
            side, link, 2 * j1, shape, u, pair, work.join
        )
        if found and _triad_attitude(s, pivot, first, second, u, hub, near, far, c):
            matches = settle(s, c, observer, sky.stars, rule, work.slots, star)
    _unchain_pairs(i0, i1, pair, work.join.head)
    return matches


@kernel
def solve_lost_in_space(s, order, observer, sky, rule, work, star, c):
    """Identify one exposure without prior knowledge; returns the number of matches, 0 = none.

    ``order`` (M,) are the brightest detections, which seed hypotheses.
    """
    arc = _measure_arcs(s, order)
    cost, triads = work.join.cost, work.join.triads
    count = _list_triads(arc, sky.pairs.limit - rule.pair_tolerance, rule, work.join)
    found, trials, t = 0, 0, _cheapest(cost, count)
    while found == 0 and trials < _TRIALS and cost[t] < math.inf:
        trials += 1
        cost[t] = math.inf
        x, y, z = _from_pivot(triads[t, 0], triads[t, 1], triads[t, 2], arc)
        found = _try_triad(
            s, order[x], order[y], order[z], (arc[x, y], arc[x, z], arc[y, z]),
            observer, sky, rule, work, star, c,
        )  # fmt: skip
        t = _cheapest(cost, count)
    if found == 0:
        star[:] = -1
    return found


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
    list1, list2 = np.empty(_CHAIN, np.int32), np.empty(_CHAIN, np.int32)
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
