"""Lost-in-space and guided hypotheses, exposure by exposure (numba)."""

from __future__ import annotations

import math

import numpy as np

from stcal.catalog.apparent_kernels import geometric_from_apparent
from stcal.jit import kernel
from stcal.matching.verify_kernels import (
    cell_of,
    refine_attitude,
    rotate_back,
    settle,
)

SOLVED, TOO_FEW_STARS, NO_MATCH = 0, 1, 2

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
def _window(low, high, sky):
    """Return the range of the pair table with separations in [low, high]."""
    last_bin = sky.pair_start.shape[0] - 1
    i = sky.pair_start[min(max(int(low / sky.pair_bin), 0), last_bin)]
    n = sky.pair_angle.shape[0]
    while i < n and sky.pair_angle[i] < low:
        i += 1
    j = sky.pair_start[min(max(int(high / sky.pair_bin), 0), last_bin)]
    j = max(i, j)
    while j < n and sky.pair_angle[j] <= high:
        j += 1
    return i, j


@kernel
def two_vector_attitude(s1, s2, u1, u2, c):
    """TRIAD: the rotation c with c u1 = s1 and c u2 in the plane of s1, s2 (Black 1964)."""
    frames = np.empty((2, 3, 3))
    for which in range(2):
        first = s1 if which == 0 else u1
        second = s2 if which == 0 else u2
        x, y, z = first[0], first[1], first[2]
        nx = y * second[2] - z * second[1]
        ny = z * second[0] - x * second[2]
        nz = x * second[1] - y * second[0]
        norm = math.sqrt(nx * nx + ny * ny + nz * nz)
        if norm < 1e-9:
            return False
        nx, ny, nz = nx / norm, ny / norm, nz / norm
        f = frames[which]
        f[0, 0], f[1, 0], f[2, 0] = x, y, z
        f[0, 1], f[1, 1], f[2, 1] = nx, ny, nz
        f[0, 2], f[1, 2], f[2, 2] = y * nz - z * ny, z * nx - x * nz, x * ny - y * nx
    for i in range(3):
        for j in range(3):
            c[i, j] = (
                frames[0, i, 0] * frames[1, j, 0]
                + frames[0, i, 1] * frames[1, j, 1]
                + frames[0, i, 2] * frames[1, j, 2]
            )
    return True


@kernel
def _list_triads(s, order, seeds, sky, rule, triads, cost):
    """Fill the triads of the brightest stars, each as (pivot, near, far) by shorter arcs first.

    The cost is the size of the join that the triad asks for; a pivot joins the two shorter arcs.
    """
    count = 0
    limit = sky.pair_limit - rule.pair_tolerance
    for x in range(seeds):
        for y in range(x + 1, seeds):
            i, j = order[x], order[y]
            a_ij = separation(s[i], s[j])
            if a_ij < rule.shortest_arc or a_ij > limit:
                continue
            for z in range(y + 1, seeds):
                k = order[z]
                a_ik, a_jk = separation(s[i], s[k]), separation(s[j], s[k])
                if min(a_ik, a_jk) < rule.shortest_arc or max(a_ik, a_jk) > limit:
                    continue
                if a_jk >= a_ij and a_jk >= a_ik:
                    pivot, first, second, short, middle = i, j, k, a_ij, a_ik
                elif a_ik >= a_ij:
                    pivot, first, second, short, middle = j, i, k, a_ij, a_jk
                else:
                    pivot, first, second, short, middle = k, i, j, a_ik, a_jk
                triads[count, 0], triads[count, 1], triads[count, 2] = pivot, first, second
                # Faint seeds are likelier false; rank costs like a wider window.
                cost[count] = (short + middle) * (1.0 + 0.15 * (x + y + z))
                count += 1
    return count


@kernel
def _try_triad(s, pivot, first, second, observer, sky, rule, work, star, c):
    """Join the two pair windows of a triad over the pivot; settle the first that passes."""
    tolerance = rule.pair_tolerance
    arc1, arc2 = separation(s[pivot], s[first]), separation(s[pivot], s[second])
    arc3 = separation(s[first], s[second])
    volume = _determinant(s[pivot], s[first], s[second])
    # Flatter than the tolerance, the handedness can't be told.
    flat = tolerance * max(arc1, arc2, arc3)
    low3 = 2.0 * math.sin(0.5 * max(arc3 - tolerance, 0.0))
    high3 = 2.0 * math.sin(0.5 * (arc3 + tolerance))
    low3, high3 = low3 * low3, high3 * high3
    i0, i1 = _window(arc1 - tolerance, arc1 + tolerance, sky)
    head, following, partner = work.head, work.following, work.partner
    n = 0
    for p in range(i0, i1):
        a, b = sky.pair_a[p], sky.pair_b[p]
        partner[n], following[n], head[a] = b, head[a], n
        n += 1
        partner[n], following[n], head[b] = a, head[b], n
        n += 1
    found = 0
    j0, j1 = _window(arc2 - tolerance, arc2 + tolerance, sky)
    for p in range(j0, j1):
        for side in range(2):
            hub = sky.pair_a[p] if side == 0 else sky.pair_b[p]
            e = head[hub]
            if e < 0:
                continue
            far = sky.pair_b[p] if side == 0 else sky.pair_a[p]
            u_hub, u_far = sky.epoch_direction[hub], sky.epoch_direction[far]
            while e >= 0:
                near = partner[e]
                e = following[e]
                u_near = sky.epoch_direction[near]
                x, y, z = u_near[0] - u_far[0], u_near[1] - u_far[1], u_near[2] - u_far[2]
                d2 = x * x + y * y + z * z
                if d2 < low3 or d2 > high3 or near == far:
                    continue
                mirror = _determinant(u_hub, u_near, u_far)
                if volume * mirror < 0.0 and (abs(volume) > flat or abs(mirror) > flat):
                    continue
                found = _settle_triad(
                    s,
                    pivot,
                    first,
                    second,
                    u_hub,
                    u_near,
                    u_far,
                    observer,
                    sky,
                    rule,
                    work,
                    star,
                    c,
                )
                if found > 0:
                    break
            if found > 0:
                break
        if found > 0:
            break
    for p in range(i0, i1):
        head[sky.pair_a[p]] = -1
        head[sky.pair_b[p]] = -1
    return found


@kernel
def _settle_triad(
    s, pivot, first, second, u_hub, u_near, u_far, observer, sky, rule, work, star, c
):
    if not two_vector_attitude(s[second], s[first], u_far, u_near, c):
        return 0
    # Least squares over the three stars before the look-up.
    star[:] = -1
    star[pivot] = star[first] = star[second] = 0
    work.target[pivot], work.target[first], work.target[second] = u_hub, u_near, u_far
    if not refine_attitude(s, work.target, star, c):
        return 0
    return settle(s, c, observer, sky, rule, star, work.target, work.distance2, work.owner)


@kernel
def solve_lost_in_space(s, order, observer, sky, rule, work, star, c):
    """Identify one exposure without prior knowledge; returns the number of matches, 0 = none."""
    seeds = min(s.shape[0], rule.seed_stars)
    count = _list_triads(s, order, seeds, sky, rule, work.triads, work.cost)
    for _ in range(min(count, _TRIALS)):
        t = 0
        for x in range(1, count):
            if work.cost[x] < work.cost[t]:
                t = x
        work.cost[t] = math.inf
        found = _try_triad(
            s, work.triads[t, 0], work.triads[t, 1], work.triads[t, 2],
            observer, sky, rule, work, star, c,
        )  # fmt: skip
        if found > 0:
            return found
    star[:] = -1
    return 0


@kernel
def _candidates(u, radius, observer, sky, out):
    """List catalogue stars within ``radius`` of an apparent direction; returns how many."""
    g = np.empty(3)
    geometric_from_apparent(u, observer, g)
    cell = cell_of(g, sky.cells)
    count = 0
    for e in range(sky.cell_start[cell], sky.cell_start[cell + 1]):
        candidate = sky.cell_star[e]
        if separation(g, sky.epoch_direction[candidate]) < radius and count < out.shape[0]:
            out[count] = candidate
            count += 1
    return count


@kernel
def solve_guided(s, order, hint, observer, sky, rule, work, star, c):
    """Identify one exposure near the attitude ``hint``; returns the number of matches, 0 = none.

    The hint itself is tried first; then pairs of bright stars whose catalogue candidates lie
    within the hint radius and whose arclength agrees.
    """
    c[:, :] = hint
    found = settle(s, c, observer, sky, rule, star, work.target, work.distance2, work.owner)
    if 2 * found > s.shape[0]:
        return found
    best, best_c = found, c.copy()
    kept = star.copy()
    u1, u2 = np.empty(3), np.empty(3)
    list1, list2 = np.empty(_CHAIN, np.int32), np.empty(_CHAIN, np.int32)
    seeds = min(s.shape[0], rule.seed_stars)
    for x in range(seeds):
        i = order[x]
        rotate_back(hint, s[i], u1)
        n1 = _candidates(u1, rule.hint_radius, observer, sky, list1)
        for y in range(x + 1, seeds if n1 > 0 else 0):
            j = order[y]
            arc = separation(s[i], s[j])
            if arc < rule.shortest_arc:
                continue
            rotate_back(hint, s[j], u2)
            n2 = _candidates(u2, rule.hint_radius, observer, sky, list2)
            for p in range(n1):
                for q in range(n2):
                    a, b = sky.epoch_direction[list1[p]], sky.epoch_direction[list2[q]]
                    if abs(separation(a, b) - arc) > rule.pair_tolerance:
                        continue
                    if not two_vector_attitude(s[i], s[j], a, b, c):
                        continue
                    found = settle(
                        s, c, observer, sky, rule, star, work.target, work.distance2, work.owner
                    )
                    if found > best:
                        best, kept[:] = found, star
                        best_c[:, :] = c
                    if 2 * best > s.shape[0]:
                        star[:] = kept
                        c[:, :] = best_c
                        return best
    star[:] = kept
    c[:, :] = best_c
    if best == 0:
        star[:] = -1
    return best
