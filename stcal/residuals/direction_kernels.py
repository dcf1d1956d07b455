"""Residual ``direction``: star directions with the attitude of each exposure projected out (numba).

The efficient yardstick: all that N stars say about the camera once their attitude is unknown is in
2 N - 3 residuals, here without any choice of pairs.  Each star has two departures in its tangent
plane; the three columns by which a small rotation moves them are taken out by Householder's
reflections, and the first three rows with them.
"""

from __future__ import annotations

import math

import numpy as np

from stcal.geometry.tangent_kernels import tangents
from stcal.jit import kernel, pointer
from stcal.matching.seed_kernels import two_vector_attitude
from stcal.matching.verify_kernels import refine_attitude, rotate, rotate_back
from stcal.residuals.contract_kernels import BIND, ROWS, noise_change
from stcal.residuals.ordering_kernels import count_pairs


@kernel
def _tables(floats, stars, parameters):
    """Return s_i (K, 3), sd (K,), slope (K, P) and reference (P,), views."""
    a, b, c = 3 * stars, 4 * stars, (4 + parameters) * stars
    return (
        floats[:a].reshape(stars, 3),
        floats[a:b],
        floats[b:c].reshape(stars, parameters),
        floats[c:],
    )


@kernel
def attitude_of(s, target, c):
    """Fill the least-squares attitude (3, 3) of directions s (N, 3) of ``target`` (N, 3)."""
    best, i0, j0 = 2.0, 0, 1
    for j in range(1, s.shape[0]):
        dot = s[0, 0] * s[j, 0] + s[0, 1] * s[j, 1] + s[0, 2] * s[j, 2]
        if dot < best:
            best, j0 = dot, j
    star = np.zeros(s.shape[0], np.int32)
    two_vector_attitude(s[i0], s[j0], target[i0], target[j0], c)
    refine_attitude(s, target, star, c)
    refine_attitude(s, target, star, c)


@kernel
def _attitude_change(c, s_d, s_i, by_parameter, a, b, out):
    """Fill how the attitude turns with the parameters (P', 3), in D.

    At the least-squares attitude the sum of u x s over stars vanishes, u = C s_i; so does its
    derivative, sum u x (ds + d x s).
    """
    matrix, torque, u = np.zeros((3, 3)), np.zeros((out.shape[0], 3)), np.empty(3)
    for k in range(a, b):
        rotate(c, s_i[k], u)
        dot = u[0] * s_d[k, 0] + u[1] * s_d[k, 1] + u[2] * s_d[k, 2]
        for i in range(3):
            j, m = (i + 1) % 3, (i + 2) % 3
            matrix[i, i] += dot
            for n in range(3):
                matrix[i, n] -= s_d[k, i] * u[n]
            for p in range(out.shape[0]):
                torque[p, i] -= u[j] * by_parameter[k, m, p] - u[m] * by_parameter[k, j, p]
    determinant, cofactor = 0.0, np.empty((3, 3))
    for i in range(3):
        j, m = (i + 1) % 3, (i + 2) % 3
        for n in range(3):
            o, q = (n + 1) % 3, (n + 2) % 3
            cofactor[i, n] = matrix[j, o] * matrix[m, q] - matrix[j, q] * matrix[m, o]
    for n in range(3):
        determinant += matrix[0, n] * cofactor[0, n]
    for p in range(out.shape[0]):
        for i in range(3):
            out[p, i] = 0.0
            if determinant != 0.0:
                for n in range(3):
                    out[p, i] += cofactor[n, i] * torque[p, n] / determinant


@kernel
def _exposure(a, b, s_d, s_i, sd, slope, parameters, reference, by_parameter):
    """Return whitened (2 N, 3 + P' + 1): by the rotation, by the parameters, and departures.

    All in I, where the catalogue's directions are: the tangent planes and the rotation's columns
    then stay the same whatever the camera, and with them what each row means.
    """
    last = by_parameter.shape[2]
    c = np.empty((3, 3))
    attitude_of(s_d[a:b], s_i[a:b], c)
    full = np.empty((2 * (b - a), last + 4))
    turn = np.empty((last, 3))
    _attitude_change(c, s_d, s_i, by_parameter, a, b, turn)
    t, t_d, measured = np.empty((2, 3)), np.empty(3), np.empty(3)
    for k in range(a, b):
        rotate_back(c, s_d[k], measured)
        tangents(s_i[k], t)
        for side in range(2):
            row = 2 * (k - a) + side
            value = 0.0
            for i in range(3):
                j, m = (i + 1) % 3, (i + 2) % 3
                # A rotation w of the attitude moves the direction by w x s.
                full[row, i] = (s_i[k, j] * t[side, m] - s_i[k, m] * t[side, j]) / sd[k]
                value += t[side, i] * (measured[i] - s_i[k, i])
            rotate(c, t[side], t_d)
            scale = 1.0 / (sd[k] * noise_change(slope, k, parameters, reference))
            for p in range(last):
                change = -value * slope[k, p]
                for i in range(3):
                    j, m = (i + 1) % 3, (i + 2) % 3
                    turned = turn[p, j] * s_d[k, m] - turn[p, m] * s_d[k, j]
                    change += t_d[i] * (by_parameter[k, i, p] + turned)
                full[row, 3 + p] = scale * change
            full[row, 3 + last] = scale * value
    return full


@kernel
def _project_out(full):
    """Reflect the rows so that the first three columns vanish below row three (Householder)."""
    count, width = full.shape
    for k in range(3):
        norm2 = 0.0
        for i in range(k, count):
            norm2 += full[i, k] * full[i, k]
        norm = math.sqrt(norm2)
        if norm == 0.0:
            continue
        sign = -1.0 if full[k, k] < 0.0 else 1.0
        full[k, k] += sign * norm
        scale = sign * norm * full[k, k]
        for j in range(k + 1, width):
            dot = 0.0
            for i in range(k, count):
                dot += full[i, k] * full[i, j]
            dot /= scale
            for i in range(k, count):
                full[i, j] -= full[i, k] * dot


@pointer(BIND)
def bind(offsets, s_i, sd, star_slope, reference, options):
    """ints: rows, 0, offsets (X + 1,); floats: s_i (K, 3), sd, slope (K, P), reference (P,)."""
    stars, parameters = s_i.shape[0], reference.shape[0]
    ints = np.zeros(2 + offsets.shape[0], np.int64)
    ints[2:] = offsets
    ints[0] = count_pairs(offsets)
    floats = np.empty(stars * (4 + parameters) + parameters)
    kept, noise, slope, at = _tables(floats, stars, parameters)
    kept[:], noise[:], slope[:], at[:] = s_i, sd, star_slope, reference
    return ints, floats


@pointer(ROWS)
def rows(ints, floats, parameters, s_d, by_parameter, out):
    """Fill the whitened rows, exposure by exposure."""
    stars = s_d.shape[0]
    s_i, sd, slope, reference = _tables(floats, stars, parameters.shape[0])
    row = 0
    for x in range(ints.shape[0] - 3):
        a, b = ints[2 + x], ints[3 + x]
        size = 2 * (b - a) - 3
        if size <= 0:
            continue
        full = _exposure(a, b, s_d, s_i, sd, slope, parameters, reference, by_parameter)
        _project_out(full)
        out[row : row + size] = full[3:, 3:]
        row += size
