"""Apparent place of one star for one observer, as kernels that the matching kernels call.

The steps are those of the IAU SOFA routines pmpx, ldsun and ab (their ERFA twins serve as the
test's oracle), with zero radial velocity and the catalogue's tangent vector as proper motion.

An observer's row holds [years, position_au (3), sun_au (3), beta (3)], see
:class:`stcal.catalog.apparent.Observer`.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from stcal.constants import AU_M, JULIAN_YEAR_S, SPEED_OF_LIGHT_M_S
from stcal.jit import kernel

Floats = NDArray[np.float64]

# Light time of one au in Julian years, for the Roemer term of the proper motion.
_LIGHT_YEARS_PER_AU = AU_M / SPEED_OF_LIGHT_M_S / JULIAN_YEAR_S
# Schwarzschild radius of the Sun in au: 2 * 1.32712440041e20 / (c^2 au) (SOFA's SRS).
_SUN_SCHWARZSCHILD_AU = 1.97412574336e-8
# Smallest q.(q + e) of the deflection formula: inside about 0.08 deg of the Sun's centre the
# deflection is held down instead of growing without limit (SOFA's ldsun).
_DEFLECTION_LIMIT = 1e-6


@kernel
def apparent_place(
    direction: Floats, motion: Floats, parallax: float, observer: Floats, out: Floats
) -> None:
    """Write the unit apparent direction (3,) of a star into ``out``.

    Parameters
    ----------
    direction : (3,) unit ICRS direction at J2000.0
    motion : (3,) rad per Julian year, tangent to ``direction``
    parallax : rad
    observer : (10,) row of ``Observer.rows``
    """
    ex, ey, ez = observer[1], observer[2], observer[3]
    x, y, z = direction[0], direction[1], direction[2]
    # Space motion and parallax (pmpx).
    years = observer[0] + _LIGHT_YEARS_PER_AU * (x * ex + y * ey + z * ez)
    x += years * motion[0] - parallax * ex
    y += years * motion[1] - parallax * ey
    z += years * motion[2] - parallax * ez
    norm = 1.0 / sqrt(x * x + y * y + z * z)
    x *= norm
    y *= norm
    z *= norm
    # Light deflection by the Sun (ldsun): p + w p x (e x p), e from the Sun to the observer.
    hx, hy, hz = observer[4], observer[5], observer[6]
    sun_au = sqrt(hx * hx + hy * hy + hz * hz)
    hx /= sun_au
    hy /= sun_au
    hz /= sun_au
    along = x * hx + y * hy + z * hz
    floor = _DEFLECTION_LIMIT / max(sun_au * sun_au, 1.0)
    w = _SUN_SCHWARZSCHILD_AU / sun_au / max(1.0 + along, floor)
    x += w * (hx - along * x)
    y += w * (hy - along * y)
    z += w * (hz - along * z)
    # Stellar aberration, relativistic, with the Sun's potential (ab).
    bx, by, bz = observer[7], observer[8], observer[9]
    lorentz = sqrt(1.0 - (bx * bx + by * by + bz * bz))
    along = x * bx + y * by + z * bz
    w1 = 1.0 + along / (1.0 + lorentz)
    w2 = _SUN_SCHWARZSCHILD_AU / sun_au
    px = lorentz * x + w1 * bx + w2 * (bx - along * x)
    py = lorentz * y + w1 * by + w2 * (by - along * y)
    pz = lorentz * z + w1 * bz + w2 * (bz - along * z)
    norm = 1.0 / sqrt(px * px + py * py + pz * pz)
    out[0] = px * norm
    out[1] = py * norm
    out[2] = pz * norm


@kernel
def geometric_from_apparent(u: Floats, observer: Floats, out: Floats) -> None:
    """Write the direction (3,) that the apparent unit direction ``u`` has without aberration.

    For looking up stars on the sky.  First order in beta: aberration itself comes back to 1.1 mas
    (beta^2 / 2).  Deflection, below 50 mas farther than 9.3 deg from the Sun, is left in; so are
    proper motion and parallax, which belong to the star.  ``out`` may be ``u``.
    """
    bx, by, bz = observer[7], observer[8], observer[9]
    along = u[0] * bx + u[1] * by + u[2] * bz
    x = u[0] * (1.0 + along) - bx
    y = u[1] * (1.0 + along) - by
    z = u[2] * (1.0 + along) - bz
    norm = 1.0 / sqrt(x * x + y * y + z * z)
    out[0] = x * norm
    out[1] = y * norm
    out[2] = z * norm


@kernel
def apparent_places(
    direction: Floats,
    motion: Floats,
    parallax: Floats,
    star: NDArray[np.int64],
    frame: NDArray[np.int64],
    observers: Floats,
    out: Floats,
) -> None:
    """Write the apparent directions (S, 3) of catalogue stars (S,) in frames (S,) into ``out``."""
    for s in range(star.shape[0]):
        c = star[s]
        apparent_place(direction[c], motion[c], parallax[c], observers[frame[s]], out[s])
