"""Johnson V and B-V from the magnitudes that Tycho-2 and Hipparcos measure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Tycho-2's own transformation (Hog et al. 2000, note to BTmag; ESA SP-1200 vol. 1, 1.3.20).
_V_PER_COLOUR, _BV_PER_COLOUR = 0.090, 0.850
# Where one of BT, VT is missing: the median BT-VT of stars brighter than V 8.
_TYPICAL_COLOUR = 0.64
# V - Hp against B-V, cubic fitted to 34,461 single stars of Hipparcos-2 with Johnson V (-0.3 < B-V
# < 2.0, rms 0.007 mag); coefficients from the constant upwards.
_V_MINUS_HP = (-0.00600781, -0.30270018, 0.14212342, 0.00157404)
_HP_COLOUR_RANGE = (-0.3, 2.0)


def johnson_from_tycho(bt: Floats, vt: Floats) -> tuple[Floats, Floats]:
    """Return Johnson V (N,) and B-V (N,) of BT and VT (N,), NaN where missing.

    One magnitude alone gives V with a typical colour (good to 0.1 mag from VT, 0.5 mag from BT) and
    no B-V; neither gives NaN.
    """
    colour = bt - vt
    from_vt = vt - _V_PER_COLOUR * np.where(np.isfinite(colour), colour, _TYPICAL_COLOUR)
    from_bt = bt - (1.0 + _V_PER_COLOUR) * _TYPICAL_COLOUR
    return np.where(np.isfinite(vt), from_vt, from_bt), _BV_PER_COLOUR * colour


def johnson_from_hipparcos(hp: Floats, colour: Floats) -> Floats:
    """Return Johnson V (N,) of Hp and B-V (N,); a typical colour where B-V is NaN."""
    usual = np.where(np.isfinite(colour), colour, _BV_PER_COLOUR * _TYPICAL_COLOUR)
    clipped = np.clip(usual, *_HP_COLOUR_RANGE)
    return np.asarray(hp + np.polynomial.polynomial.polyval(clipped, _V_MINUS_HP))
