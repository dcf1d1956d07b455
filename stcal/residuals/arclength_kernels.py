"""Residual ``arclength``: covariance and whitening, exposure by exposure (numba)."""

from __future__ import annotations

import math

import numpy as np

from stcal.jit import kernel, pointer
from stcal.residuals.contract_kernels import BIND, ROWS, noise_change
from stcal.residuals.ordering_kernels import count_pairs, order_stars

# Rows k and l of an exposure share a star only when |k - l| <= 4.
BAND = 4
# A pivot below this part of its variance is a dependent arclength: what it would add lies below
# the second-order terms that R leaves out.
_DEPENDENT = 1e-3


@kernel
def distance2(s, i, j):
    """Square of the chord between rows i and j of unit vectors (K, 3).

    Stars are named by their rows: to make a view of each would cost more than the arithmetic.
    """
    x, y, z = s[i, 0] - s[j, 0], s[i, 1] - s[j, 1], s[i, 2] - s[j, 2]
    return x * x + y * y + z * z


@kernel
def _tangent(s, i, j, out, row, side):
    """Write the unit tangent at star i towards star j to ``out[row, side]``."""
    d = s[i, 0] * s[j, 0] + s[i, 1] * s[j, 1] + s[i, 2] * s[j, 2]
    x, y, z = s[j, 0] - d * s[i, 0], s[j, 1] - d * s[i, 1], s[j, 2] - d * s[i, 2]
    scale = 1.0 / math.sqrt(x * x + y * y + z * z)
    out[row, side, 0], out[row, side, 1], out[row, side, 2] = scale * x, scale * y, scale * z


@kernel
def list_arcs(offsets, s_i, pair_i, pair_j, starts):
    """Fill the stars (A,) of the 2 N - 3 arcs of each exposure, and the exposure's first arc."""
    order = np.empty(s_i.shape[0], np.int64)
    order_stars(offsets, s_i, order)
    row = 0
    for x in range(offsets.shape[0] - 1):
        start, last = row, offsets[x + 1]
        for i in range(offsets[x], last - 1):
            for j in range(i + 1, min(i + 3, last)):
                pair_i[row], pair_j[row], starts[row] = order[i], order[j], start
                row += 1


@kernel
def arc_angle(s, i, j):
    """Return the angle [rad] between rows i and j of unit vectors (K, 3)."""
    return 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(distance2(s, i, j))))


@kernel
def arc_errors(pair_i, pair_j, s_d, s_i, out):
    """Fill the arclength errors (A,) in rad, eq (12)."""
    for row in range(pair_i.shape[0]):
        i, j = pair_i[row], pair_j[row]
        out[row] = arc_angle(s_d, i, j) - arc_angle(s_i, i, j)


@kernel
def factor(starts, s_i, sd, pair_i, pair_j, lower):
    """Factor the covariance of the arcs of each exposure; return the number of dependent arcs.

    ``lower`` (A, BAND + 1) is the banded Cholesky factor of R, eqs (16)-(18): lower[k, BAND - d] =
    L[k, k - d].  cos psi of (18) is the product of the tangents at the shared star.  The diagonal
    is infinite for a dependent arc, which drops out.
    """
    # Unit tangents of each arc at its two stars, towards the other one.
    tangent = np.empty((pair_i.shape[0], 2, 3))
    dropped = 0
    for row in range(pair_i.shape[0]):
        a, b, start = pair_i[row], pair_j[row], starts[row]
        _tangent(s_i, a, b, tangent, row, 0)
        _tangent(s_i, b, a, tangent, row, 1)
        lower[row, BAND] = sd[a] * sd[a] + sd[b] * sd[b]
        for d in range(1, BAND + 1):
            value = 0.0
            if row - d >= start:
                value = _shared(sd, pair_i, pair_j, tangent, row, row - d)
            lower[row, BAND - d] = value
        dropped += _cholesky_row(lower, row, start)
    return dropped


@kernel
def _shared(sd, pair_i, pair_j, tangent, row, other):
    """Covariance of two arcs, eq (17): zero unless they share a star."""
    for side in range(2):
        hub = pair_i[row] if side == 0 else pair_j[row]
        for back in range(2):
            if hub == (pair_i[other] if back == 0 else pair_j[other]):
                cosine = 0.0
                for k in range(3):
                    cosine += tangent[row, side, k] * tangent[other, back, k]
                return sd[hub] * sd[hub] * cosine
    return 0.0


@kernel
def _cholesky_row(lower, row, start):
    variance = lower[row, BAND]
    for d in range(BAND, -1, -1):
        column = row - d
        if column < start:
            continue
        value = lower[row, BAND - d]
        for k in range(max(start, row - BAND), column):
            value -= lower[row, BAND - (row - k)] * lower[column, BAND - (column - k)]
        if d > 0:
            lower[row, BAND - d] = value / lower[column, BAND]
        elif value > _DEPENDENT * variance:
            lower[row, BAND] = math.sqrt(value)
        else:
            lower[row, BAND] = math.inf
            return 1
    return 0


@kernel
def arc_stars(ints):
    """Return pair_i, pair_j and starts (A,), views of what ``bind`` has made."""
    count = ints[0]
    return ints[2 : 2 + count], ints[2 + count : 2 + 2 * count], ints[2 + 2 * count :]


@kernel
def arc_tables(ints, floats, parameters):
    """Return lower (A, BAND + 1), arc (A,), slope (A, P) and reference (P,), views."""
    count = ints[0]
    a, b = count * (BAND + 1), count * (BAND + 2)
    c = b + count * parameters
    lower, slope = floats[:a].reshape(count, BAND + 1), floats[b:c].reshape(count, parameters)
    return lower, floats[a:b], slope, floats[c:]


@pointer(BIND)
def bind(offsets, s_i, sd, star_slope, reference, options):
    """Choose the arcs of the exposures and factor their covariance.

    ints: rows, dependent, then pair_i, pair_j, starts (A,); floats: lower (A, BAND + 1), arc (A,),
    slope (A, P), reference (P,).
    """
    parameters = reference.shape[0]
    count = count_pairs(offsets)
    ints = np.empty(2 + 3 * count, np.int64)
    floats = np.empty(count * (BAND + 2 + parameters) + parameters)
    ints[0] = count
    pair_i, pair_j, starts = arc_stars(ints)
    lower, arc, slope, kept = arc_tables(ints, floats, parameters)
    list_arcs(offsets, s_i, pair_i, pair_j, starts)
    ints[1] = factor(starts, s_i, sd, pair_i, pair_j, lower)
    kept[:] = reference
    for a in range(count):
        i, j = pair_i[a], pair_j[a]
        arc[a] = arc_angle(s_i, i, j)
        # An arc's log-sd slope is the mean of its stars', weighted by variance.
        share = sd[i] * sd[i] / (sd[i] * sd[i] + sd[j] * sd[j])
        for p in range(parameters):
            slope[a, p] = share * star_slope[i, p] + (1.0 - share) * star_slope[j, p]
    return ints, floats


@pointer(ROWS)
def rows(ints, floats, parameters, s_d, by_parameter, out):
    """Fill the whitened rows [H' | residual] at a camera.

    Residuals are eq (12), rows of H eq (38) with the terms crossed; then the triangular systems
    (81)-(82), row by row within the band.
    """
    pair_i, pair_j, starts = arc_stars(ints)
    lower, arc_true, slope, reference = arc_tables(ints, floats, parameters.shape[0])
    last = by_parameter.shape[2]
    for row in range(ints[0]):
        i, j = pair_i[row], pair_j[row]
        half = min(1.0, 0.5 * math.sqrt(distance2(s_d, i, j)))
        departure = 2.0 * math.asin(half) - arc_true[row]
        sine = 2.0 * half * math.sqrt(1.0 - half * half)
        weight = 1.0 / noise_change(slope, row, parameters, reference)
        for p in range(last):
            value = 0.0
            for a in range(3):
                value += by_parameter[j, a, p] * s_d[i, a] + by_parameter[i, a, p] * s_d[j, a]
            out[row, p] = weight * (-value / sine - departure * slope[row, p])
        out[row, last] = weight * departure
        for k in range(max(starts[row], row - BAND), row):
            weight = lower[row, BAND - (row - k)]
            if weight != 0.0:
                for p in range(last + 1):
                    out[row, p] -= weight * out[k, p]
        for p in range(last + 1):
            out[row, p] /= lower[row, BAND]
