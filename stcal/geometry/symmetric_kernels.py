"""Eigenvalues, eigenvectors and inverses of symmetric 3 x 3 matrices (numba)."""

from __future__ import annotations

import math

from stcal.jit import kernel

_SWEEPS = 12


@kernel
def eigen3(a, values, vectors):
    """Fill falling eigenvalues (3,) and eigenvectors as columns (3, 3) of ``a``, which is spoilt.

    Jacobi's rotations: exact to rounding for small eigenvalues beside large ones.
    """
    for i in range(3):
        for j in range(3):
            vectors[i, j] = 1.0 if i == j else 0.0
    for _ in range(_SWEEPS):
        off = abs(a[0, 1]) + abs(a[0, 2]) + abs(a[1, 2])
        if off <= 1e-18 * (abs(a[0, 0]) + abs(a[1, 1]) + abs(a[2, 2])):
            break
        for p in range(2):
            for q in range(p + 1, 3):
                _rotate_pair(a, vectors, p, q)
    for i in range(3):
        values[i] = a[i, i]
    for i in range(2):
        for j in range(2 - i):
            if values[j] < values[j + 1]:
                values[j], values[j + 1] = values[j + 1], values[j]
                for k in range(3):
                    vectors[k, j], vectors[k, j + 1] = vectors[k, j + 1], vectors[k, j]


@kernel
def _rotate_pair(a, vectors, p, q):
    """One Jacobi rotation that makes a[p, q] vanish (Golub & Van Loan, section 8.5)."""
    if a[p, q] == 0.0:
        return
    tau = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
    t = (1.0 if tau >= 0.0 else -1.0) / (abs(tau) + math.sqrt(1.0 + tau * tau))
    c = 1.0 / math.sqrt(1.0 + t * t)
    s = t * c
    for k in range(3):
        left, right = a[k, p], a[k, q]
        a[k, p], a[k, q] = c * left - s * right, s * left + c * right
    for k in range(3):
        left, right = a[p, k], a[q, k]
        a[p, k], a[q, k] = c * left - s * right, s * left + c * right
    for k in range(3):
        left, right = vectors[k, p], vectors[k, q]
        vectors[k, p], vectors[k, q] = c * left - s * right, s * left + c * right


@kernel
def adjugate3(a, out):
    """Fill the adjugate (3, 3) of ``a``, the inverse times the determinant; return the latter."""
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for p in range(3):
            q, r = (p + 1) % 3, (p + 2) % 3
            out[p, i] = a[j, q] * a[k, r] - a[j, r] * a[k, q]
    return a[0, 0] * out[0, 0] + a[0, 1] * out[1, 0] + a[0, 2] * out[2, 0]
