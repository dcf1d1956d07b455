"""Lost-in-space identification of one exposure by triads of bright stars (numba).

A triad's two shorter arcs each select a window of the pair table; joining the two over the shared
star, and the third arc and the handedness, leave few catalogue triangles.
"""

from __future__ import annotations

import math

import numpy as np

from stcal.jit import kernel
from stcal.matching.seed_kernels import separation, two_vector_attitude
from stcal.matching.settle_kernels import another_agrees, settle
from stcal.matching.verify_kernels import best_rotation, distance2

# An exposure that its thirty best triads don't solve was not solved by 150 either.
_TRIALS = 30


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
                # Faint seeds are likelier false; rank costs like a wider window.
                cost = (a + b + c - longest) * (1.0 + 0.15 * (x + y + z))
                usable = (shortest >= rule.shortest_arc) & (longest <= limit) & (cost < math.inf)
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
def _list_joined(j0, j1, pair, join):
    """List the places in a window's pairs, two a pair, whose star has a chain; returns how many.

    Each with the chain's first link.  Like :func:`_next_links` without branches, which would mostly
    be mispredicted.
    """
    count = 0
    for p in range(j0, j1):
        for side in range(2):
            link = join.head[pair[p, side]]
            join.joined[count, 0], join.joined[count, 1] = 2 * p + side, link
            count += link >= 0
    return count


@kernel
def _next_links(count, middle2, half2, u, pair, join):
    """Test the triangles of the first ``count`` places in ``join.joined`` with their link.

    Lists (hub, near, far) of those whose third side is right, and keeps the places whose chain goes
    on.  Returns the numbers of both.
    """
    joined, triangles, chain = join.joined, join.triangles, join.chain
    found, left = 0, 0
    for k in range(count):
        place, link = joined[k, 0], joined[k, 1]
        hub, far = pair[place >> 1, place & 1], pair[place >> 1, 1 - (place & 1)]
        link, near = chain[link, 0], chain[link, 1]
        d2 = distance2(u[near, 0], u[near, 1], u[near, 2], u, far)
        triangles[found, 0], triangles[found, 1], triangles[found, 2] = hub, near, far
        found += (abs(d2 - middle2) <= half2) & (near != far)
        joined[left, 0], joined[left, 1] = place, link
        left += link >= 0
    return found, left


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
def _try_triangle(s, triad, shape, hub, near, far, observer, sky, rule, work, star, c):
    """Settle from one catalogue triangle; returns the number of matches, 0 when refused.

    ``shape`` holds the triad's volume, and below which the handedness can't be told.
    """
    u, (volume, flat) = sky.stars.direction, shape
    mirror = _determinant(u[hub], u[near], u[far])
    if volume * mirror < 0.0 and max(abs(volume), abs(mirror)) > flat:
        return 0
    if not _triad_attitude(s, triad[0], triad[1], triad[2], u, hub, near, far, c):
        return 0
    # Most triangles are chance, and no further star agrees with them: the check would refuse them.
    if rule.minimum_matches > 3 and not another_agrees(s, triad, c, observer, sky.stars, rule):
        return 0
    return settle(s, c, observer, sky.stars, rule, work.slots, star)


@kernel
def _try_triad(s, triad, arcs, observer, sky, rule, work, star, c):
    """Join the two pair windows of a triad over the pivot; settle the first that passes."""
    tolerance, u, pair, join = rule.pair_tolerance, sky.stars.direction, sky.pairs.pair, work.join
    i0, i1 = _window(arcs[0] - tolerance, arcs[0] + tolerance, sky.pairs)
    j0, j1 = _window(arcs[1] - tolerance, arcs[1] + tolerance, sky.pairs)
    low = 2.0 * math.sin(0.5 * max(arcs[2] - tolerance, 0.0))
    high = 2.0 * math.sin(0.5 * (arcs[2] + tolerance))
    middle2, half2 = 0.5 * (high * high + low * low), 0.5 * (high * high - low * low)
    # Flatter than the tolerance, the handedness can't be told.
    flat = tolerance * max(arcs[0], arcs[1], arcs[2])
    shape = _determinant(s[triad[0]], s[triad[1]], s[triad[2]]), flat
    _chain_pairs(i0, i1, pair, join)
    left, matches = _list_joined(j0, j1, pair, join), 0
    while left > 0 and matches == 0:
        found, left = _next_links(left, middle2, half2, u, pair, join)
        for k in range(found):
            hub, near, far = join.triangles[k, 0], join.triangles[k, 1], join.triangles[k, 2]
            matches = _try_triangle(
                s, triad, shape, hub, near, far, observer, sky, rule, work, star, c
            )  # fmt: skip
            if matches > 0:
                break
    _unchain_pairs(i0, i1, pair, join.head)
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
            s, (order[x], order[y], order[z]), (arc[x, y], arc[x, z], arc[y, z]),
            observer, sky, rule, work, star, c,
        )  # fmt: skip
        t = _cheapest(cost, count)
    if found == 0:
        star[:] = -1
    return found
