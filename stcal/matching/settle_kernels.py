"""The geometric consistency check that both identification methods end in (numba).

From an approximate attitude of one exposure: match every detection to the nearest catalogue star,
refit the attitude, and repeat until the set of matches no longer changes.  Attitudes near the
truth all lead to the same fixed point.
"""

from __future__ import annotations

from stcal.catalog.apparent_kernels import apparent_place, geometric_from_apparent
from stcal.jit import kernel
from stcal.matching.verify_kernels import (
    accept,
    distance2,
    nearest_star,
    refine_attitude,
    rotated,
    rotated_back,
)

_ROUNDS = 12
# The first look-up allows for the coarse attitude of a hypothesis.
_FIRST_RADIUS = 2.5
# The look-up by geometric direction is a little wider than the exact check behind it.
_MARGIN_RAD = 2e-6
# What is between an apparent place and the index's epoch: half a year's proper motion and parallax.
_GAP_MARGIN_RAD = 1e-4


@kernel
def settle(s, c, observer, stars, rule, slots, star):
    """Run the check from the attitude ``c``; returns the number of matches, 0 when refused.

    ``star`` (N,) and ``c`` are left at the fixed point, the apparent places in ``slots.target``.
    """
    star[:] = -1
    count, _ = _assign(s, c, _first_radius(rule, stars), observer, stars, slots, star)
    changed, rounds = True, 0
    while changed and count >= rule.minimum_matches and rounds < _ROUNDS:
        rounds += 1
        if refine_attitude(s, slots.target, star, c):
            count, changed = _assign(s, c, rule.star_tolerance, observer, stars, slots, star)
        else:
            count = 0
    # Where nothing changed, all are within the tolerance of their own attitude already.
    if changed and count >= rule.minimum_matches:
        count = _tighten(s, c, rule, star, slots.target)
    return count if accept(count, s.shape[0], rule) else 0


@kernel
def _first_radius(rule, stars):
    return min(_FIRST_RADIUS * rule.star_tolerance, stars.radius)


@kernel
def another_agrees(s, triad, c, observer, stars, rule):
    """Return whether the first look-up finds a star for a detection that isn't in ``triad``."""
    radius = _first_radius(rule, stars) + _MARGIN_RAD
    for k in range(s.shape[0]):
        if k != triad[0] and k != triad[1] and k != triad[2]:
            x, y, z = rotated_back(c, s[k, 0], s[k, 1], s[k, 2])
            x, y, z = geometric_from_apparent(x, y, z, observer)
            if nearest_star(x, y, z, radius, stars) >= 0:
                return True
    return False


@kernel
def _assign(s, c, radius, observer, stars, slots, star):
    """Match each detection to the nearest star within ``radius``; nearest wins a shared star.

    Returns the number of matches and whether any match changed.
    """
    target, departure, owner, before = slots.target, slots.distance2, slots.owner, slots.before
    table = stars.star
    for k in range(s.shape[0]):
        found = star[k]
        before[k] = found
        known = False
        if found >= 0:
            # Well within half the gap to the next star, no other can be nearer.
            free = table[found, 7] - _GAP_MARGIN_RAD
            departure[k] = departure2(s, c, target, k)
            known = free > 0.0 and departure[k] < free * free
        if not known:
            x, y, z = rotated_back(c, s[k, 0], s[k, 1], s[k, 2])
            x, y, z = geometric_from_apparent(x, y, z, observer)
            found = nearest_star(x, y, z, radius + _MARGIN_RAD, stars)
            if found >= 0:
                if found != slots.placed[k]:
                    slots.placed[k] = found
                    target[k, 0], target[k, 1], target[k, 2] = apparent_place(
                        table[found, 0], table[found, 1], table[found, 2],
                        table[found, 3], table[found, 4], table[found, 5], table[found, 6],
                        observer,
                    )  # fmt: skip
                departure[k] = departure2(s, c, target, k)
        star[k] = -1
        if found >= 0 and departure[k] <= radius * radius:
            rival = owner[found]
            if rival < 0 or departure[k] < departure[rival]:
                star[k] = found
                owner[found] = k
                if rival >= 0:
                    star[rival] = -1
    return _close_round(star, before, owner)


@kernel
def _close_round(star, before, owner):
    """Free the owners; return the number of matches and whether any differs from ``before``."""
    count, changed = 0, False
    for k in range(star.shape[0]):
        changed |= star[k] != before[k]
        if star[k] >= 0:
            owner[star[k]] = -1
            count += 1
    return count, changed


@kernel
def departure2(s, c, target, k):
    """Return the squared distance of detection ``k`` from the place beside it."""
    x, y, z = rotated(c, target[k, 0], target[k, 1], target[k, 2])
    return distance2(x, y, z, s, k)


@kernel
def _tighten(s, c, rule, star, target):
    """Refit and drop the worst star until all are within the tolerance of their own attitude.

    Returns the number of matches left, 0 where they don't fix an attitude.
    """
    count, worst = 1, 0
    while worst >= 0 and count > 0:
        count, worst, worst2 = 0, -1, rule.star_tolerance * rule.star_tolerance
        if refine_attitude(s, target, star, c):
            for k in range(s.shape[0]):
                if star[k] >= 0:
                    count += 1
                    d2 = departure2(s, c, target, k)
                    if d2 > worst2:
                        worst, worst2 = k, d2
            if worst >= 0:
                star[worst] = -1
    return count
