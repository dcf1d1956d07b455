"""Arclength residuals of one telemetry frame, for estimators that take frame after frame (numba).

The same ordering, covariance and whitening as the batch (``arclength_kernels``), on the two
exposures of a frame.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stcal.jit import kernel
from stcal.residuals.arclength_kernels import BAND, distance2, factor, order_stars, whiten


class Arcs(NamedTuple):
    """The arcs of a frame, as ``stcal.residuals.arclength.BoundArclength`` has them for many."""

    pair_i: NDArray[np.int64]
    pair_j: NDArray[np.int64]
    lower: NDArray[np.float64]
    starts: NDArray[np.int64]
    arc: NDArray[np.float64]
    slope: NDArray[np.float64]
    reference: NDArray[np.float64]
    dependent: int


@kernel
def bind_frame(offsets, s_i, sd, star_slope, reference):
    """Choose the arcs of the exposures ``offsets`` (3,) and factor their covariance.

    s_i (K, 3); sd (K,) rad at the camera parameters ``reference`` (P,), with derivatives of their
    logarithm ``star_slope`` (K, P).
    """
    order = np.empty(s_i.shape[0], np.int64)
    order_stars(offsets, s_i, order)
    count = 0
    for x in range(offsets.shape[0] - 1):
        count += max(2 * (offsets[x + 1] - offsets[x]) - 3, 0)
    pair_i, pair_j = np.empty(count, np.int64), np.empty(count, np.int64)
    lower = np.zeros((count, BAND + 1))
    dependent = factor(offsets, s_i, order, sd, pair_i, pair_j, lower)
    starts, arc = np.empty(count, np.int64), np.empty(count)
    slope = np.empty((count, reference.shape[0]))
    row = 0
    for x in range(offsets.shape[0] - 1):
        arcs = max(2 * (offsets[x + 1] - offsets[x]) - 3, 0)
        starts[row : row + arcs] = row
        row += arcs
    for a in range(count):
        i, j = pair_i[a], pair_j[a]
        arc[a] = 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(distance2(s_i, i, j))))
        share = sd[i] * sd[i] / (sd[i] * sd[i] + sd[j] * sd[j])
        for p in range(reference.shape[0]):
            slope[a, p] = share * star_slope[i, p] + (1.0 - share) * star_slope[j, p]
    return Arcs(pair_i, pair_j, lower, starts, arc, slope, reference.copy(), dependent)


@kernel
def whiten_frame(arcs, parameters, s_d, by_parameter, out):
    """Fill ``out`` (A, P' + 1) with whitened [H | residual] at the camera parameters (P,).

    s_d (K, 3) and ``by_parameter`` (K, 3, P') belong to these parameters; P' is P, or 0 where only
    residuals are wanted.
    """
    scale = np.empty(arcs.arc.shape[0])
    for a in range(scale.shape[0]):
        change = 0.0
        for p in range(parameters.shape[0]):
            change += arcs.slope[a, p] * (parameters[p] - arcs.reference[p])
        scale[a] = math.exp(change)
    whiten(
        arcs.pair_i, arcs.pair_j, arcs.lower, arcs.starts, arcs.arc, scale, arcs.slope,
        s_d, by_parameter, out,
    )  # fmt: skip
