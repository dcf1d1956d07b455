"""Attitude of one exposure from its attitude profile, and the covariance of its error (numba)."""

from __future__ import annotations

import math

import numpy as np

from stcal.geometry.symmetric_kernels import adjugate3, eigen3
from stcal.geometry.tangent_kernels import tangents
from stcal.jit import kernel

# An information whose least eigenvalue is below this part of the largest fixes no attitude.
_SINGULAR = 1e-12


@kernel
def wahba(profile, c):
    """Fill the attitude c (3, 3), D from I, of a profile B = sum w s_d s_i^T (Markley 1988).

    The best attitude takes B's first right singular vector to its first left one.  What is left is
    a turn about the latter, in closed form: so no small singular value needs to be squared, and
    narrow fields lose no more to rounding than by B's own.
    """
    square, values, right = np.zeros((3, 3)), np.empty(3), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                square[i, j] += profile[k, i] * profile[k, j]
    eigen3(square, values, right)
    e, f = np.empty((3, 3)), np.empty((3, 3))
    norm = 0.0
    for i in range(3):
        e[0, i] = right[i, 0]
        f[0, i] = (
            profile[i, 0] * right[0, 0] + profile[i, 1] * right[1, 0] + profile[i, 2] * right[2, 0]
        )
        norm += f[0, i] * f[0, i]
    f[0] /= math.sqrt(norm)
    tangents(e[0], e[1:])
    tangents(f[0], f[1:])
    cosine, sine = 0.0, 0.0
    for i in range(3):
        for j in range(3):
            cosine += profile[i, j] * (f[1, i] * e[1, j] + f[2, i] * e[2, j])
            sine += profile[i, j] * (f[2, i] * e[1, j] - f[1, i] * e[2, j])
    length = math.sqrt(cosine * cosine + sine * sine)
    cosine, sine = (cosine / length, sine / length) if length > 0.0 else (1.0, 0.0)
    for i in range(3):
        first, second = cosine * f[1, i] + sine * f[2, i], cosine * f[2, i] - sine * f[1, i]
        for j in range(3):
            c[i, j] = f[0, i] * e[0, j] + first * e[1, j] + second * e[2, j]


@kernel
def add_to_profile(weight, s_d, s_i, k, profile):
    """Add w s_d s_i^T of star k to an attitude profile (3, 3)."""
    for i in range(3):
        for j in range(3):
            profile[i, j] += weight * s_d[k, i] * s_i[k, j]


@kernel
def add_to_information(weight, s_d, k, information):
    """Add w (1 - s s^T) of star k to the information (3, 3) on the attitude's error in D."""
    for i in range(3):
        for j in range(3):
            information[i, j] += weight * ((1.0 if i == j else 0.0) - s_d[k, i] * s_d[k, j])


@kernel
def invert_information(a, out):
    """Fill the inverse (3, 3) of an information; NaN where it fixes no attitude."""
    determinant = adjugate3(a, out)
    minors = out[0, 0] + out[1, 1] + out[2, 2]
    # With a least eigenvalue that small the minors sum to the product of the other two.
    if determinant > _SINGULAR * minors * 0.5 * (a[0, 0] + a[1, 1] + a[2, 2]):
        out /= determinant
    else:
        out[:, :] = math.nan


@kernel
def solve_attitudes(s_d, s_i, weight, exposure, c_di):
    """Fill the attitudes (E, 3, 3) of exposures; stars (S,) say to which they belong.

    NaN with under two stars of positive weight.
    """
    count, profile = np.zeros(c_di.shape[0], np.int64), np.zeros(c_di.shape)
    for k in range(s_d.shape[0]):
        count[exposure[k]] += weight[k] > 0.0
        add_to_profile(weight[k], s_d, s_i, k, profile[exposure[k]])
    for x in range(c_di.shape[0]):
        if count[x] >= 2:
            wahba(profile[x], c_di[x])
        else:
            c_di[x] = math.nan


@kernel
def sum_information(s_d, weight, exposure, total):
    """Fill sum w (1 - s s^T) (E, 3, 3) of the stars (S,) of each exposure."""
    total[:, :, :] = 0.0
    for k in range(s_d.shape[0]):
        add_to_information(weight[k], s_d, k, total[exposure[k]])


@kernel
def invert_each(a, out):
    """Fill the inverses (E, 3, 3) of informations."""
    for x in range(a.shape[0]):
        invert_information(a[x], out[x])
