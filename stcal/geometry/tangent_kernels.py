"""Axes of a tangent plane (numba)."""

from __future__ import annotations

import math

from stcal.jit import kernel


@kernel
def tangents(b, t):
    """Fill two unit vectors (2, 3) perpendicular to the direction b and to each other.

    b, t[0] and t[1] are right-handed.
    """
    least = 0
    for i in range(1, 3):
        if abs(b[i]) < abs(b[least]):
            least = i
    norm = math.sqrt(1.0 - b[least] * b[least])
    for i in range(3):
        t[0, i] = ((1.0 if i == least else 0.0) - b[least] * b[i]) / norm
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        t[1, i] = b[j] * t[0, k] - b[k] * t[0, j]
