"""What every residual provides, as function pointers of fixed signatures (numba).

``bind(offsets, s_i, sd, star_slope, reference, options) -> (ints, floats)`` makes everything that
the camera doesn't change: offsets (X + 1,) of the exposures; s_i (K, 3); sd (K,) rad at the camera
parameters ``reference`` (P,), with derivatives of their logarithm ``star_slope`` (K, P); options
(O,) of the residual.  What it returns is the residual's own business but for ints[0], the number of
rows, and ints[1], how many of them carry nothing new.

``rows(ints, floats, parameters, s_d, by_parameter, out)`` fills ``out`` (A, P' + 1) with whitened
[H | residual] at the camera parameters (P,), to which s_d (K, 3) and by_parameter (K, 3, P')
belong; P' is P, or 0 where only residuals are wanted.

Noise in pixels is constant, so in rad it changes with the camera: residuals are divided by how
their sd changes since ``reference``, and that division is differentiated (``noise_change``).
"""

from __future__ import annotations

import math

from numba import float64, int64, types, void

from stcal.jit import kernel

_NUMBERS, _COLUMN, _TABLE = int64[::1], float64[::1], float64[:, ::1]
BIND = types.Tuple((_NUMBERS, _COLUMN))(_NUMBERS, _TABLE, _COLUMN, _TABLE, _COLUMN, _COLUMN)
ROWS = void(_NUMBERS, _COLUMN, _COLUMN, _TABLE, float64[:, :, ::1], _TABLE)


@kernel
def noise_change(slope, row, parameters, reference):
    """Return by how much the sd of a row has changed, with logarithmic slopes (A, P)."""
    change = 0.0
    for p in range(parameters.shape[0]):
        change += slope[row, p] * (parameters[p] - reference[p])
    return math.exp(change)
