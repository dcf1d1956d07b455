"""The geometric consistency check that both identification methods end in (numba).

From an approximate attitude of one exposure: match every detection to the nearest catalogue star,
refit the attitude, and repeat until the set of matches no longer changes.  Attitudes near the
truth all lead to the same fixed point.
"""

from __future__ import annotations

import math

import numpy as np

from stcal.catalog.apparent_kernels import apparent_place, geometric_from_apparent
from stcal.jit import kernel

_ROUNDS = 12
# The first look-up allows for the coarse attitude of a hypothesis.
_FIRST_RADIUS = 2.5


@kernel
def cell_of(u, cells):
    """Return the cube-map cell of a direction; the twin of ``index.cube_cell``."""
    axis = 0
    if abs(u[1]) > abs(u[axis]):
        axis = 1
    if abs(u[2]) > abs(u[axis]):
        axis = 2
    major = abs(u[axis])
    a = math.atan(u[(axis + 1) % 3] / major) / (0.5 * math.pi) + 0.5
    b = math.atan(u[(axis + 2) % 3] / major) / (0.5 * math.pi) + 0.5
    i = min(max(int(a * cells), 0), cells - 1)
    j = min(max(int(b * cells), 0), cells - 1)
    face = 2 * axis + (1 if u[axis] < 0 else 0)
    return (face * cells + i) * cells + j


@kernel
def rotate(c, v, out):
    """out = c v."""
    for i in range(3):
        out[i] = c[i, 0] * v[0] + c[i, 1] * v[1] + c[i, 2] * v[2]


@kernel
def rotate_back(c, v, out):
    """out = c^T v."""
    for i in range(3):
        out[i] = c[0, i] * v[0] + c[1, i] * v[1] + c[2, i] * v[2]


@kernel
def _distance2(a, b):
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return x * x + y * y + z * z


@kernel
def refine_attitude(s, target, star, c):
    """Turn ``c`` (I to D) to the least-squares attitude of the matched stars, in place.

    Gauss-Newton on the small rotation: sum (1 - b b^T) d = sum b x s with b = c u.  Two rounds
    from some milliradians reach rounding.  Returns False where the stars don't fix the attitude.
    """
    b = np.empty(3)
    for _ in range(2):
        a00 = a01 = a02 = a11 = a12 = a22 = 0.0
        g0 = g1 = g2 = 0.0
        for k in range(s.shape[0]):
            if star[k] < 0:
                continue
            rotate(c, target[k], b)
            a00 += 1.0 - b[0] * b[0]
            a01 -= b[0] * b[1]
            a02 -= b[0] * b[2]
            a11 += 1.0 - b[1] * b[1]
            a12 -= b[1] * b[2]
            a22 += 1.0 - b[2] * b[2]
            g0 += b[1] * s[k, 2] - b[2] * s[k, 1]
            g1 += b[2] * s[k, 0] - b[0] * s[k, 2]
            g2 += b[0] * s[k, 1] - b[1] * s[k, 0]
        m00, m01, m02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
        det = a00 * m00 + a01 * m01 + a02 * m02
        if not abs(det) > 1e-12:
            return False
        m11, m12, m22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
        x = (m00 * g0 + m01 * g1 + m02 * g2) / det
        y = (m01 * g0 + m11 * g1 + m12 * g2) / det
        z = (m02 * g0 + m12 * g1 + m22 * g2) / det
        _turn(c, x, y, z)
    return True


@kernel
def _turn(c, x, y, z):
    """c <- R c with R the rotation by the vector (x, y, z)."""
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < 1e-300:
        return
    h = math.sin(0.5 * angle) / angle
    q0, q1, q2, q3 = h * x, h * y, h * z, math.cos(0.5 * angle)
    r00, r11 = 1 - 2 * (q1 * q1 + q2 * q2), 1 - 2 * (q0 * q0 + q2 * q2)
    r22 = 1 - 2 * (q0 * q0 + q1 * q1)
    r01, r10 = 2 * (q0 * q1 - q2 * q3), 2 * (q0 * q1 + q2 * q3)
    r02, r20 = 2 * (q0 * q2 + q1 * q3), 2 * (q0 * q2 - q1 * q3)
    r12, r21 = 2 * (q1 * q2 - q0 * q3), 2 * (q1 * q2 + q0 * q3)
    for j in range(3):
        a, b, d = c[0, j], c[1, j], c[2, j]
        c[0, j] = r00 * a + r01 * b + r02 * d
        c[1, j] = r10 * a + r11 * b + r12 * d
        c[2, j] = r20 * a + r21 * b + r22 * d


@kernel
def nearest_star(g, radius, sky):
    """Return the catalogue star nearest to the geometric direction ``g``, or -1."""
    cell = cell_of(g, sky.cells)
    best, best2 = -1, radius * radius
    for e in range(sky.cell_start[cell], sky.cell_start[cell + 1]):
        candidate = sky.cell_star[e]
        d2 = _distance2(g, sky.epoch_direction[candidate])
        if d2 < best2:
            best, best2 = candidate, d2
    return best


@kernel
def _assign(s, c, radius, observer, sky, star, target, distance2, owner):
    """Match each detection to the nearest star within ``radius``; nearest wins a shared star.

    Returns the number of matches and whether any match changed.
    """
    u, g, b = np.empty(3), np.empty(3), np.empty(3)
    changed = False
    count = 0
    for k in range(s.shape[0]):
        rotate_back(c, s[k], u)
        geometric_from_apparent(u, observer, g)
        # A little more than the radius: the exact place decides below.
        found = nearest_star(g, radius + 2e-6, sky)
        before = star[k]
        if found >= 0:
            if found != before:
                apparent_place(
                    sky.direction[found],
                    sky.motion[found],
                    sky.parallax[found],
                    observer,
                    target[k],
                )
            rotate(c, target[k], b)
            distance2[k] = _distance2(b, s[k])
            if distance2[k] > radius * radius:
                found = -1
        star[k] = found
        if found >= 0:
            rival = owner[found]
            if rival >= 0:
                loser = k if distance2[rival] <= distance2[k] else rival
                winner = rival if loser == k else k
                star[loser] = -1
                owner[found] = winner
            else:
                owner[found] = k
                count += 1
        if star[k] != before:
            changed = True
    for k in range(s.shape[0]):
        if star[k] >= 0:
            owner[star[k]] = -1
    return count, changed


@kernel
def log_choose(n, k):
    """Natural logarithm of the binomial coefficient."""
    return math.lgamma(n + 1.0) - math.lgamma(k + 1.0) - math.lgamma(n - k + 1.0)


@kernel
def accept(matches, detections, rule):
    """Whether chance can't explain the matches: an a-contrario bound on the false alarms.

    A hypothesis sets two detections on two catalogue stars; the others then fall on a star by
    chance with probability p each.  With H ordered catalogue pairs for each detected pair, the
    expected number of sets of k matches among N detections is H C(N, k) p^(k - 2).
    """
    if matches < rule.minimum_matches:
        return False
    log_alarms = (
        math.log(rule.hypotheses)
        + log_choose(detections, matches)
        + (matches - 2) * math.log(rule.chance)
    )
    return log_alarms < math.log(rule.false_alarm)


@kernel
def settle(s, c, observer, sky, rule, star, target, distance2, owner):
    """Run the check from the attitude ``c``; returns the number of matches, 0 when refused.

    ``star`` (N,) and ``c`` are left at the fixed point.
    """
    star[:] = -1
    radius = min(_FIRST_RADIUS * rule.star_tolerance, sky.radius)
    count, _ = _assign(s, c, radius, observer, sky, star, target, distance2, owner)
    for _ in range(_ROUNDS):
        if count < rule.minimum_matches or not refine_attitude(s, target, star, c):
            return 0
        count, changed = _assign(
            s, c, rule.star_tolerance, observer, sky, star, target, distance2, owner
        )
        if not changed:
            break
    if not _tighten(s, c, rule, star, target):
        return 0
    count = 0
    for k in range(s.shape[0]):
        count += star[k] >= 0
    return count if accept(count, s.shape[0], rule) else 0


@kernel
def _tighten(s, c, rule, star, target):
    """Refit and drop the worst star until all are within the tolerance of their own attitude."""
    b = np.empty(3)
    tolerance2 = rule.star_tolerance * rule.star_tolerance
    for _ in range(s.shape[0]):
        if not refine_attitude(s, target, star, c):
            return False
        worst, worst2 = -1, tolerance2
        for k in range(s.shape[0]):
            if star[k] < 0:
                continue
            rotate(c, target[k], b)
            d2 = _distance2(b, s[k])
            if d2 > worst2:
                worst, worst2 = k, d2
        if worst < 0:
            return True
        star[worst] = -1
    return False
