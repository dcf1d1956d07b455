"""Consistency of matches that come from elsewhere, before an attitude is made of them (numba)."""

from __future__ import annotations

import numpy as np

from stcal.jit import kernel
from stcal.matching.seed_kernels import separation, two_vector_attitude
from stcal.matching.verify_kernels import rotate


@kernel
def keep_consistent(offsets, s_d, s_i, star, tolerance, shortest):
    """Unmatch, in place, the stars of each exposure that its best attitude doesn't explain.

    Every pair of matched stars whose arclength agrees within ``tolerance`` [rad] proposes an
    attitude; the one that brings most stars within the tolerance is kept.  ``star`` (S,) is -1
    where unmatched; an exposure without any agreeing pair is unmatched as a whole.
    """
    c, b = np.empty((3, 3)), np.empty(3)
    for e in range(offsets.shape[0] - 1):
        first, last = offsets[e], offsets[e + 1]
        near = np.zeros(last - first, np.bool_)
        kept = np.zeros(last - first, np.bool_)
        best = 0
        for i in range(first, last):
            for j in range(i + 1, last):
                if star[i] < 0 or star[j] < 0 or 2 * best > last - first:
                    continue
                arc = separation(s_i[i], s_i[j])
                if arc < shortest or abs(separation(s_d[i], s_d[j]) - arc) > tolerance:
                    continue
                if not two_vector_attitude(s_d[i], s_d[j], s_i[i], s_i[j], c):
                    continue
                count = 0
                for k in range(first, last):
                    near[k - first] = False
                    if star[k] >= 0:
                        rotate(c, s_i[k], b)
                        near[k - first] = separation(b, s_d[k]) < tolerance
                        count += near[k - first]
                if count > best:
                    best = count
                    kept[:] = near
        for k in range(first, last):
            if not kept[k - first]:
                star[k] = -1
