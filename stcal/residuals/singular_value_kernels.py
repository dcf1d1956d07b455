"""Residual ``singular-values``: of star groups against the catalogue, Wu et al. 2019 (numba).

The singular values of the matrix of a group's directions don't change with the attitude, eq (18).
Groups are those of section 3.3.2, options[0]: 1, three stars each (1-2-3, 2-3-4, ...); 2, half the
stars each; 3, all but one; 4, growing (1-2-3, 1-2-3-4, ...).  options[1:4] say which of the three
values are used.  As the squares sum to the number of stars, two of the three are independent.

The derivative is analytic, d sigma = p^T dW q with q = W^T p / sigma.  Groups share stars: rows are
whitened with their full covariance (the paper takes them as independent and of one variance).
"""

from __future__ import annotations

import math

import numpy as np

from stcal.geometry.symmetric_kernels import eigen3
from stcal.jit import kernel, pointer
from stcal.residuals.contract_kernels import BIND, ROWS, noise_change

# Values are linear in the noise only while they, and their distance from the next value, are large
# beside their sd: one that is below so many sd, or so near another, drops out.
_SMALLEST = 100.0
# What a row adds to the rows before it (its pivot) must be as large, in sd, beside the second-order
# term sd^2 / distance: below that whitening would blow the second order up.  (With a fixed limit of
# 1e-9 chi2 per row at the true camera was 1.5 to 27 for 0.5 px noise and a 16 mm lens.)
_SECOND_ORDER = 30.0
# And a pivot below this part of its variance is rounding.
_DEPENDENT = 1e-9


@kernel
def group_of(model, stars, number):
    """Return the first star and the size of group ``number`` of an exposure; size 0 beyond."""
    if model == 4:
        return (0, number + 3) if number + 3 <= stars else (0, 0)
    size = 3 if model == 1 else (stars // 2 if model == 2 else stars - 1)
    size = max(size, 3)
    return (number, size) if number + size <= stars else (0, 0)


@kernel
def _count_rows(offsets, options):
    used = 0
    for k in range(1, 4):
        used += options[k] != 0.0
    total, factor = 0, 0
    for x in range(offsets.shape[0] - 1):
        number, mine = 0, 0
        while group_of(int(options[0]), offsets[x + 1] - offsets[x], number)[1] > 0:
            number += 1
            mine += used
        total += mine
        factor += mine * (mine + 1) // 2
    return total, factor


@kernel
def _decompose(s, first, size, values, vectors):
    """Fill singular values (3,) and left singular vectors (3, 3) of a group's directions."""
    a = np.zeros((3, 3))
    for k in range(first, first + size):
        for i in range(3):
            for j in range(i, 3):
                a[i, j] += s[k, i] * s[k, j]
    a[1, 0], a[2, 0], a[2, 1] = a[0, 1], a[0, 2], a[1, 2]
    eigen3(a, values, vectors)
    for k in range(3):
        values[k] = math.sqrt(max(values[k], 0.0))


@kernel
def _mean_slope(s, sd, star_slope, first, size, p, out):
    """Fill the log-sd slope (P,) of one value: the mean of its stars', weighted by variance."""
    total = 0.0
    out[:] = 0.0
    for k in range(first, first + size):
        along = p[0] * s[k, 0] + p[1] * s[k, 1] + p[2] * s[k, 2]
        weight = sd[k] * sd[k] * (1.0 - along * along) * along * along
        total += weight
        for q in range(out.shape[0]):
            out[q] += weight * star_slope[k, q]
    if total > 0.0:
        out /= total


@kernel
def _covariance(facts, floats, vectors, s, sd, a, b):
    """Covariance of two singular values: sum over shared stars of sd^2 q q' p^T (1 - s s^T) p'."""
    first = max(facts[a, 0], facts[b, 0])
    last = min(facts[a, 0] + facts[a, 1], facts[b, 0] + facts[b, 1])
    p, q = vectors[a], vectors[b]
    between = p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
    total = 0.0
    for k in range(first, last):
        u = p[0] * s[k, 0] + p[1] * s[k, 1] + p[2] * s[k, 2]
        v = q[0] * s[k, 0] + q[1] * s[k, 1] + q[2] * s[k, 2]
        total += sd[k] * sd[k] * u * v * (between - u * v)
    return total / (floats[a] * floats[b])


@kernel
def _is_linear(pivot, variance, apart):
    """Whether a row's own part, after those before it, is still linear in the noise."""
    second_order = _SECOND_ORDER**2 * variance / (apart * apart) if apart > 0.0 else math.inf
    return (
        apart > _SMALLEST * math.sqrt(variance) and pivot > max(_DEPENDENT, second_order) * variance
    )


@kernel
def _factor(facts, floats, vectors, apart, s, sd, start, stop):
    """Fill the Cholesky rows of one exposure; returns the number of rows that drop out."""
    dropped = 0
    for a in range(start, stop):
        place = facts[a, 4]
        # Two stars at one place make a value zero, which has no derivative.
        variance = _covariance(facts, floats, vectors, s, sd, a, a) if apart[a] > 0.0 else math.inf
        pivot = variance
        for b in range(start, a):
            other = facts[b, 4]
            last = floats[other + b - start]
            if not variance < math.inf or last == math.inf:
                floats[place + b - start] = 0.0
                continue
            value = _covariance(facts, floats, vectors, s, sd, a, b)
            for k in range(b - start):
                value -= floats[place + k] * floats[other + k]
            value /= last
            floats[place + b - start] = value
            pivot -= value * value
        if variance < math.inf and _is_linear(pivot, variance, apart[a]):
            floats[place + a - start] = math.sqrt(pivot)
        else:
            floats[place + a - start] = math.inf
            dropped += 1
    return dropped


@pointer(BIND)
def bind(offsets, s_i, sd, star_slope, reference, options):
    """Decompose the groups by the catalogue and factor the covariance of their singular values.

    ints: rows, dependent, then for each row (A, 5) its group's first star and size, which value,
    the first row of the exposure, where its row of the factor starts; floats: sigma (A,), slope
    (A, P), reference (P,), and the rows of the Cholesky factors, triangle after triangle.
    """
    parameters = reference.shape[0]
    count, triangle = _count_rows(offsets, options)
    ints = np.zeros(2 + 5 * count, np.int64)
    floats = np.zeros(count * (1 + parameters) + parameters + triangle)
    ints[0] = count
    facts = ints[2:].reshape(count, 5)
    slope = floats[count : count * (1 + parameters)].reshape(count, parameters)
    floats[count * (1 + parameters) : count * (1 + parameters) + parameters] = reference
    vectors, apart = np.empty((count, 3)), np.empty(count)
    values, left = np.empty(3), np.empty((3, 3))
    row, place = 0, count * (1 + parameters) + parameters
    for x in range(offsets.shape[0] - 1):
        start, number = row, 0
        while True:
            first, size = group_of(int(options[0]), offsets[x + 1] - offsets[x], number)
            if size == 0:
                break
            first += offsets[x]
            _decompose(s_i, first, size, values, left)
            for k in range(3):
                if options[1 + k] != 0.0:
                    facts[row, 0], facts[row, 1], facts[row, 2] = first, size, k
                    facts[row, 3], facts[row, 4] = start, place
                    floats[row], vectors[row] = values[k], left[:, k]
                    apart[row] = values[k]
                    for other in range(3):
                        if other != k:
                            apart[row] = min(apart[row], abs(values[k] - values[other]))
                    _mean_slope(s_i, sd, star_slope, first, size, left[:, k].copy(), slope[row])
                    place += row - start + 1
                    row += 1
            number += 1
        ints[1] += _factor(facts, floats, vectors, apart, s_i, sd, start, row)
    return ints, floats


@pointer(ROWS)
def rows(ints, floats, parameters, s_d, by_parameter, out):
    """Fill the whitened rows, group by group."""
    count, last, size = ints[0], by_parameter.shape[2], parameters.shape[0]
    facts = ints[2:].reshape(count, 5)
    slope = floats[count : count * (1 + size)].reshape(count, size)
    reference = floats[count * (1 + size) : count * (1 + size) + size]
    values, left, p = np.empty(3), np.empty((3, 3)), np.empty(3)
    first, stars = -1, 0
    for a in range(count):
        if facts[a, 0] != first or facts[a, 1] != stars:
            first, stars = facts[a, 0], facts[a, 1]
            _decompose(s_d, first, stars, values, left)
        which, start, place = facts[a, 2], facts[a, 3], facts[a, 4]
        if floats[place + a - start] == math.inf:
            out[a] = 0.0
            continue
        p[:] = left[:, which]
        departure = values[which] - floats[a]
        scale = 1.0 / noise_change(slope, a, parameters, reference)
        out[a, :last] = 0.0
        for k in range(first, first + stars):
            along = p[0] * s_d[k, 0] + p[1] * s_d[k, 1] + p[2] * s_d[k, 2]
            for q in range(last):
                out[a, q] += along * (
                    p[0] * by_parameter[k, 0, q]
                    + p[1] * by_parameter[k, 1, q]
                    + p[2] * by_parameter[k, 2, q]
                )
        for q in range(last):
            out[a, q] = scale * (out[a, q] / values[which] - departure * slope[a, q])
        out[a, last] = scale * departure
        for b in range(start, a):
            weight = floats[place + b - start]
            if weight != 0.0:
                for q in range(last + 1):
                    out[a, q] -= weight * out[b, q]
        for q in range(last + 1):
            out[a, q] /= floats[place + a - start]
