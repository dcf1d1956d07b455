"""The parts of the geometric consistency check: rotation, attitude, look-up, acceptance (numba).

Vectors go as three numbers where a kernel is called star by star: making a small array would cost
more than the arithmetic.
"""

from __future__ import annotations

import math

from stcal.jit import kernel

# After a Newton step below this [rad] the error is rounding.
_LAST_STEP = 1e-8
_STEPS = 6
# Determinant of the normal matrix below which the stars don't fix the attitude.
_FLAT = 1e-12


@kernel
def rotated(c, x, y, z):
    """Return c v."""
    return (
        c[0, 0] * x + c[0, 1] * y + c[0, 2] * z,
        c[1, 0] * x + c[1, 1] * y + c[1, 2] * z,
        c[2, 0] * x + c[2, 1] * y + c[2, 2] * z,
    )


@kernel
def rotated_back(c, x, y, z):
    """Return c^T v."""
    return (
        c[0, 0] * x + c[1, 0] * y + c[2, 0] * z,
        c[0, 1] * x + c[1, 1] * y + c[2, 1] * z,
        c[0, 2] * x + c[1, 2] * y + c[2, 2] * z,
    )


@kernel
def rotate(c, v, out):
    """out = c v."""
    out[0], out[1], out[2] = rotated(c, v[0], v[1], v[2])


@kernel
def rotate_back(c, v, out):
    """out = c^T v."""
    out[0], out[1], out[2] = rotated_back(c, v[0], v[1], v[2])


@kernel
def copy_rows(table, out, rows):
    """Copy vectors (rows, 3); a slice assignment would check for overlap."""
    for i in range(rows):
        out[i, 0], out[i, 1], out[i, 2] = table[i, 0], table[i, 1], table[i, 2]


@kernel
def refine_attitude(s, target, star, c):
    """Turn ``c`` (I to D) to the least-squares attitude of the matched stars, in place.

    Returns False where the stars don't fix the attitude.
    """
    p00 = p01 = p02 = p10 = p11 = p12 = p20 = p21 = p22 = 0.0
    for k in range(s.shape[0]):
        if star[k] < 0:
            continue
        x, y, z = target[k, 0], target[k, 1], target[k, 2]
        p00 += s[k, 0] * x
        p01 += s[k, 0] * y
        p02 += s[k, 0] * z
        p10 += s[k, 1] * x
        p11 += s[k, 1] * y
        p12 += s[k, 1] * z
        p20 += s[k, 2] * x
        p21 += s[k, 2] * y
        p22 += s[k, 2] * z
    return best_rotation((p00, p01, p02, p10, p11, p12, p20, p21, p22), c)


@kernel
def best_rotation(profile, c):
    """Turn ``c``, some degrees off at most, to the maximum of trace(c P^T), in place.

    ``profile`` holds Wahba's P = sum s u^T, row by row, so that the stars are gone through once.
    Newton's method on the small rotation d: with M = P c^T, (tr(M) 1 - (M + M^T) / 2) d = a, a the
    antisymmetric part sum (c u) x s.  Returns False where the stars don't fix the attitude.
    """
    step2, det, steps = 1.0, 1.0, 0
    while step2 > _LAST_STEP * _LAST_STEP and det > _FLAT and steps < _STEPS:
        steps += 1
        m00, m01, m02 = rotated(c, profile[0], profile[1], profile[2])
        m10, m11, m12 = rotated(c, profile[3], profile[4], profile[5])
        m20, m21, m22 = rotated(c, profile[6], profile[7], profile[8])
        h00, h11, h22 = m11 + m22, m00 + m22, m00 + m11
        h01, h02, h12 = -0.5 * (m01 + m10), -0.5 * (m02 + m20), -0.5 * (m12 + m21)
        a0, a1, a2 = m21 - m12, m02 - m20, m10 - m01
        i00, i01, i02 = h11 * h22 - h12 * h12, h02 * h12 - h01 * h22, h01 * h12 - h02 * h11
        i11, i12, i22 = h00 * h22 - h02 * h02, h01 * h02 - h00 * h12, h00 * h11 - h01 * h01
        det = h00 * i00 + h01 * i01 + h02 * i02
        if det > _FLAT:
            x = (i00 * a0 + i01 * a1 + i02 * a2) / det
            y = (i01 * a0 + i11 * a1 + i12 * a2) / det
            z = (i02 * a0 + i12 * a1 + i22 * a2) / det
            _turn(c, 0.5 * x, 0.5 * y, 0.5 * z)
            step2 = x * x + y * y + z * z
    return det > _FLAT


@kernel
def _turn(c, x, y, z):
    """c <- R c with R the rotation of the quaternion along (x, y, z, 1)."""
    n = 2.0 / (1.0 + x * x + y * y + z * z)
    r00, r11, r22 = 1.0 - n * (y * y + z * z), 1.0 - n * (x * x + z * z), 1.0 - n * (x * x + y * y)
    r01, r10 = n * (x * y - z), n * (x * y + z)
    r02, r20 = n * (x * z + y), n * (x * z - y)
    r12, r21 = n * (y * z - x), n * (y * z + x)
    for j in range(3):
        a, b, d = c[0, j], c[1, j], c[2, j]
        c[0, j] = r00 * a + r01 * b + r02 * d
        c[1, j] = r10 * a + r11 * b + r12 * d
        c[2, j] = r20 * a + r21 * b + r22 * d


@kernel
def cell_of(x, y, z, cells):
    """Return the cube-map cell of a direction; the twin of ``index.cube_cell``."""
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        axis, major, u, v = 0, x, y, z
    elif ay >= az:
        axis, major, u, v = 1, y, z, x
    else:
        axis, major, u, v = 2, z, x, y
    half = 0.5 * cells
    scale = half / abs(major)
    # Both bounds, since a number that is not finite may come by.
    i = min(max(int(u * scale + half), 0), cells - 1)
    j = min(max(int(v * scale + half), 0), cells - 1)
    face = 2 * axis + (1 if major < 0.0 else 0)
    return (face * cells + i) * cells + j


@kernel
def nearest_star(x, y, z, radius, stars):
    """Return the catalogue star nearest to a geometric direction within ``radius``, or -1."""
    cell = cell_of(x, y, z, stars.cells)
    best, best2 = -1, radius * radius
    for e in range(stars.cell_start[cell], stars.cell_start[cell + 1]):
        d2 = distance2(x, y, z, stars.direction, stars.cell_star[e])
        if d2 < best2:
            best, best2 = stars.cell_star[e], d2
    return best


@kernel
def distance2(x, y, z, table, k):
    """Return the squared distance of a vector from row ``k`` of a table (N, 3)."""
    x, y, z = x - table[k, 0], y - table[k, 1], z - table[k, 2]
    return x * x + y * y + z * z


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
