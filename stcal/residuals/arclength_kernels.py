"""Ordering, covariance and whitening of arclengths, exposure by exposure (numba)."""

from __future__ import annotations

import math

import numpy as np

from stcal.jit import kernel

# Rows k and l of an exposure share a star only when |k - l| <= 4.
BAND = 4
# A triple with a smallest angle below this (sine) makes its arcs nearly dependent.
_FLAT = 0.2
# A pivot below this part of its variance is a dependent arclength: what it would add lies below
# the second-order terms that R leaves out.
_DEPENDENT = 1e-3


@kernel
def _length(a, b):
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return math.sqrt(x * x + y * y + z * z)


@kernel
def flatness(a, b, c):
    """Sine of the smallest angle of a triangle of stars: 0 for collinear ones, and for needles."""
    volume = abs(
        a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
    )
    p, q, r = _length(a, b), _length(b, c), _length(a, c)
    shortest = min(p, q, r)
    return volume * shortest / (p * q * r) if shortest > 0.0 else 0.0


@kernel
def _worst_triple(s, order):
    worst, where = 2.0, 0
    for k in range(order.shape[0] - 2):
        q = flatness(s[order[k]], s[order[k + 1]], s[order[k + 2]])
        if q < worst:
            worst, where = q, k
    return worst, where


@kernel
def _order_one(s, order):
    """Greedy: the next star makes the least flat triple; then swaps mend the flattest."""
    n = order.shape[0]
    for k in range(2, n - 1):
        best, pick = -1.0, k
        for j in range(k, n):
            q = flatness(s[order[k - 2]], s[order[k - 1]], s[order[j]])
            if q > best:
                best, pick = q, j
        order[k], order[pick] = order[pick], order[k]
    worst, where = _worst_triple(s, order)
    for _ in range(n):
        if worst >= _FLAT:
            break
        better, at, other = worst, -1, -1
        for i in range(where, where + 3):
            for j in range(n):
                order[i], order[j] = order[j], order[i]
                now, _ = _worst_triple(s, order)
                if now > better:
                    better, at, other = now, i, j
                order[i], order[j] = order[j], order[i]
        if at < 0:
            break
        order[at], order[other] = order[other], order[at]
        worst, where = _worst_triple(s, order)


@kernel
def order_stars(offsets, s_i, order):
    """Number the stars of each exposure so that no three in sequence are collinear.

    Enright 2018 section II-B; ``order`` (K,) is filled with indices into the selection.
    """
    for x in range(offsets.shape[0] - 1):
        first, last = offsets[x], offsets[x + 1]
        local = np.arange(last - first)
        _order_one(s_i[first:last], local)
        order[first:last] = first + local


@kernel
def _tangent(a, b, out):
    """Unit tangent at ``a`` towards ``b``."""
    d = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    x, y, z = b[0] - d * a[0], b[1] - d * a[1], b[2] - d * a[2]
    norm = math.sqrt(x * x + y * y + z * z)
    out[0], out[1], out[2] = x / norm, y / norm, z / norm


@kernel
def factor(offsets, s_i, order, sd, pair_i, pair_j, lower):
    """List the 2 N - 3 arcs of each exposure and factor their covariance.

    ``pair_i``, ``pair_j`` (A,) are the stars of each arc; ``lower`` (A, BAND + 1) is the banded
    Cholesky factor of R, eqs (16)-(18): lower[k, BAND - d] = L[k, k - d].  cos psi of (18) is the
    product of the tangents at the shared star.  The diagonal is infinite for a dependent arc,
    which drops out.  Returns the number of dependent arcs.
    """
    here, there = np.empty(3), np.empty(3)
    dropped = 0
    row = 0
    for x in range(offsets.shape[0] - 1):
        first, last = offsets[x], offsets[x + 1]
        start = row
        for i in range(first, last - 1):
            for step in range(1, 3):
                if i + step >= last:
                    continue
                pair_i[row], pair_j[row] = order[i], order[i + step]
                for d in range(BAND + 1):
                    other = row - d
                    value = 0.0
                    if d == 0:
                        value = sd[pair_i[row]] ** 2 + sd[pair_j[row]] ** 2
                    elif other >= start:
                        value = _shared(s_i, sd, pair_i, pair_j, row, other, here, there)
                    lower[row, BAND - d] = value
                dropped += _cholesky_row(lower, row, start)
                row += 1
    return dropped


@kernel
def _shared(s_i, sd, pair_i, pair_j, row, other, here, there):
    """Covariance of two arcs, eq (17): zero unless they share a star."""
    for side in range(2):
        hub = pair_i[row] if side == 0 else pair_j[row]
        end = pair_j[row] if side == 0 else pair_i[row]
        for back in range(2):
            if hub == (pair_i[other] if back == 0 else pair_j[other]):
                far = pair_j[other] if back == 0 else pair_i[other]
                _tangent(s_i[hub], s_i[end], here)
                _tangent(s_i[hub], s_i[far], there)
                cosine = here[0] * there[0] + here[1] * there[1] + here[2] * there[2]
                return sd[hub] ** 2 * cosine
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
def whiten(pair_i, pair_j, lower, starts, arc_true, scale, slope, s_d, by_parameter, out):
    """Fill ``out`` (A, P + 1) with the whitened rows [H' | residual] at a camera.

    Residuals are eq (12), rows of H eq (38) with the terms crossed, both over the noise ``scale``
    (A,) with its logarithmic derivatives ``slope`` (A, P); then the triangular systems (81)-(82),
    row by row within the band.
    """
    parameters = by_parameter.shape[2]
    for row in range(pair_i.shape[0]):
        i, j = pair_i[row], pair_j[row]
        half = 0.5 * _length(s_d[i], s_d[j])
        arc = 2.0 * math.asin(min(1.0, half))
        sine = math.sin(arc)
        for p in range(parameters):
            value = 0.0
            for a in range(3):
                value += by_parameter[j, a, p] * s_d[i, a] + by_parameter[i, a, p] * s_d[j, a]
            out[row, p] = (-value / sine - (arc - arc_true[row]) * slope[row, p]) / scale[row]
        out[row, parameters] = (arc - arc_true[row]) / scale[row]
        for k in range(max(starts[row], row - BAND), row):
            weight = lower[row, BAND - (row - k)]
            if weight != 0.0:
                for p in range(parameters + 1):
                    out[row, p] -= weight * out[k, p]
        for p in range(parameters + 1):
            out[row, p] /= lower[row, BAND]
