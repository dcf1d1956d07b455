"""How far the stars of an exposure depart from its attitude, and which go too far (numba).

For a batch, whose camera is taken as it is; ``screening_kernels`` allows for its uncertainty.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import boolean, float64, int64, types, void
from numpy.typing import NDArray

from stcal.attitude_kernels import (
    add_to_information,
    add_to_profile,
    invert_information,
    wahba,
)
from stcal.cameras.noise_kernels import noise_scale
from stcal.cameras.unit_kernels import CAMERA_SIGNATURE
from stcal.jit import kernel, pointer

# A star that the attitude follows almost wholly tells little about itself.
_LEAST_FREEDOM = 0.1


class Work(NamedTuple):
    """Scratch for one exposure: attitude profile, information, attitude and covariance (3, 3)."""

    profile: NDArray[np.float64]
    information: NDArray[np.float64]
    c_di: NDArray[np.float64]
    covariance: NDArray[np.float64]


@kernel
def _solve(s_d, s_i, sd, kept, work):
    """Solve the attitude of the kept stars with weights 1 / sd^2, and its covariance."""
    work.profile[:, :], work.information[:, :] = 0.0, 0.0
    count = 0
    for k in range(sd.shape[0]):
        if kept[k]:
            weight = 1.0 / (sd[k] * sd[k])
            add_to_profile(weight, s_d, s_i, k, work.profile)
            add_to_information(weight, s_d, k, work.information)
            count += 1
    if count < 2:
        work.c_di[:, :], work.covariance[:, :] = math.nan, math.nan
    else:
        wahba(work.profile, work.c_di)
        invert_information(work.information, work.covariance)


@kernel
def _departure(s_d, s_i, sd, k, work):
    """Return the studentised departure of star k."""
    angle2, followed = 0.0, 0.0
    for i in range(3):
        difference, along = s_d[k, i], 0.0
        for j in range(3):
            difference -= work.c_di[i, j] * s_i[k, j]
            along += work.covariance[i, j] * s_d[k, j]
        angle2 += difference * difference
        followed += work.covariance[i, i] - s_d[k, i] * along
    expected = 1.0 - 0.5 * followed / (sd[k] * sd[k])
    # NaN stays NaN.
    if expected < _LEAST_FREEDOM:
        expected = _LEAST_FREEDOM
    return math.sqrt(angle2 / expected) / sd[k]


@kernel
def _judge(s_d, s_i, sd, limit, minimum, kept, departure, work):
    """Unmark stars beyond ``limit``, the worst at a time, while ``minimum`` are left."""
    left = sd.shape[0]
    while True:
        _solve(s_d, s_i, sd, kept, work)
        worst = 0.0
        for k in range(sd.shape[0]):
            if kept[k]:
                departure[k] = _departure(s_d, s_i, sd, k, work)
                if not departure[k] <= worst:
                    worst = departure[k]
        if not worst > limit:
            return
        for k in range(sd.shape[0]):
            if kept[k] and departure[k] == worst:
                kept[k] = False
                left -= 1
        if left < minimum:
            return


def _judge_stars(
    camera, x, pixel_size_m, offsets, row_px, col_px, s_i, sd_px, limit, minimum, kept, departure
):  # fmt: skip
    """Fill each star's departure (K,) in units of its noise, and unmark in ``kept`` (K,) the worst.

    Camera parameters x (P,); exposures by offsets (X + 1,); s_i (K, 3); sd_px (K,).
    """
    largest = 0
    for e in range(offsets.shape[0] - 1):
        largest = max(largest, offsets[e + 1] - offsets[e])
    s_d, by_pixel = np.empty((largest, 3)), np.empty((largest, 3, 2))
    by_parameter, sd = np.empty((largest, 3, x.shape[0])), np.empty(largest)
    work = Work(np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)))
    for e in range(offsets.shape[0] - 1):
        a, b = offsets[e], offsets[e + 1]
        n = b - a
        camera(
            x, pixel_size_m, row_px[a:b], col_px[a:b], s_d[:n], by_parameter[:n], by_pixel[:n]
        )  # fmt: skip
        for k in range(n):
            sd[k] = sd_px[a + k] * noise_scale(by_pixel, k)
        _judge(s_d[:n], s_i[a:b], sd[:n], limit, minimum, kept[a:b], departure[a:b], work)


judge_stars = pointer(
    void(
        types.FunctionType(CAMERA_SIGNATURE), float64[::1], float64, int64[::1], float64[::1],
        float64[::1], float64[:, ::1], float64[::1], float64, int64, boolean[::1], float64[::1],
    )
)(_judge_stars)  # fmt: skip
