"""Residual ``cosine``: inner products of star pairs, as Samaan 2001 and Zhang 2024 eq (23) (numba).

As published, all pairs have one variance and are taken as independent: an error of the cosine is
sin(phi) times that of the arc (Enright 2018 eq 11), so that wide pairs weigh more than they should,
and the shared stars of the pairs are ignored.  The pairs are those of the arclengths, 2 N - 3 an
exposure; the variance is their mean one.  The sd that comes of it is too small or too large.
"""

from __future__ import annotations

import math

import numpy as np

from stcal.jit import pointer
from stcal.residuals.contract_kernels import BIND, ROWS, noise_change
from stcal.residuals.ordering_kernels import count_pairs, order_stars


@pointer(BIND)
def bind(offsets, s_i, sd, star_slope, reference, options):
    """ints: rows, 0, then pair_i, pair_j (A,); floats: cosine, sd (A,), slope (A, P), reference."""
    parameters = reference.shape[0]
    order = np.empty(s_i.shape[0], np.int64)
    order_stars(offsets, s_i, order)
    count = count_pairs(offsets)
    ints, floats = (
        np.zeros(2 + 2 * count, np.int64),
        np.empty(count * (2 + parameters) + parameters),
    )
    ints[0] = count
    floats[count * (2 + parameters) :] = reference
    slope = floats[2 * count : count * (2 + parameters)].reshape(count, parameters)
    row = 0
    for x in range(offsets.shape[0] - 1):
        start, total = row, 0.0
        for i in range(offsets[x], offsets[x + 1] - 1):
            for step in range(1, 3):
                if i + step >= offsets[x + 1]:
                    continue
                a, b = order[i], order[i + step]
                ints[2 + row], ints[2 + count + row] = a, b
                cosine = s_i[a, 0] * s_i[b, 0] + s_i[a, 1] * s_i[b, 1] + s_i[a, 2] * s_i[b, 2]
                floats[row] = cosine
                variance = sd[a] * sd[a] + sd[b] * sd[b]
                total += (1.0 - cosine * cosine) * variance
                for p in range(parameters):
                    first, second = (
                        sd[a] * sd[a] * star_slope[a, p],
                        sd[b] * sd[b] * star_slope[b, p],
                    )
                    slope[row, p] = (first + second) / variance
                row += 1
        if row > start:
            floats[count + start : count + row] = math.sqrt(total / (row - start))
    return ints, floats


@pointer(ROWS)
def rows(ints, floats, parameters, s_d, by_parameter, out):
    """Fill [H | residual] over the common sd of the exposure's pairs."""
    count, last, size = ints[0], by_parameter.shape[2], parameters.shape[0]
    slope = floats[2 * count : count * (2 + size)].reshape(count, size)
    reference = floats[count * (2 + size) :]
    for row in range(count):
        i, j = ints[2 + row], ints[2 + count + row]
        value = s_d[i, 0] * s_d[j, 0] + s_d[i, 1] * s_d[j, 1] + s_d[i, 2] * s_d[j, 2] - floats[row]
        scale = noise_change(slope, row, parameters, reference) * floats[count + row]
        for p in range(last):
            change = 0.0
            for a in range(3):
                change += by_parameter[j, a, p] * s_d[i, a] + by_parameter[i, a, p] * s_d[j, a]
            out[row, p] = (change - value * slope[row, p]) / scale
        out[row, last] = value / scale
