"""Apparent place of one star for one observer, as kernels that the matching kernels call.

The steps are those of the IAU SOFA routines pmpx, ldsun and ab (their ERFA twins serve as the
test's oracle), with zero radial velocity and the catalogue's tangent vector as proper motion.

An observer's row is one of :attr:`stcal.catalog.apparent.Observer.rows`: what all stars of an
exposure share is made once there.
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


@kernel
def apparent_place(
    x: float, y: float, z: float, mx: float, my: float, mz: float, parallax: float, observer: Floats
) -> tuple[float, float, float]:
    """Return the unit apparent direction of a star.

    Parameters
    ----------
    x, y, z : unit ICRS direction at J2000.0
    mx, my, mz : motion, rad per Julian year, tangent to the direction
    parallax : rad
    observer : (13,) row of ``Observer.rows``
    """
    ex, ey, ez = observer[1], observer[2], observer[3]
    # Space motion and parallax (pmpx).
    years = observer[0] + _LIGHT_YEARS_PER_AU * (x * ex + y * ey + z * ez)
    x += years * mx - parallax * ex
    y += years * my - parallax * ey
    z += years * mz - parallax * ez
    norm = 1.0 / sqrt(x * x + y * y + z * z)
    x *= norm
    y *= norm
    z *= norm
    # Light deflection by the Sun (ldsun): p + w p x (e x p), e from the Sun to the observer.
    hx, hy, hz, strength = observer[4], observer[5], observer[6], observer[11]
    along = x * hx + y * hy + z * hz
    w = strength / max(1.0 + along, observer[12])
    x += w * (hx - along * x)
    y += w * (hy - along * y)
    z += w * (hz - along * z)
    # Stellar aberration, relativistic, with the Sun's potential (ab).
    bx, by, bz, lorentz = observer[7], observer[8], observer[9], observer[10]
    along = x * bx + y * by + z * bz
    w = 1.0 + strength + along / (1.0 + lorentz)
    lorentz -= strength * along
    x = lorentz * x + w * bx
    y = lorentz * y + w * by
    z = lorentz * z + w * bz
    norm = 1.0 / sqrt(x * x + y * y + z * z)
    return x * norm, y * norm, z * norm


@kernel
def geometric_from_apparent(
    x: float, y: float, z: float, observer: Floats
) -> tuple[float, float, float]:
    """Return the direction that an apparent unit direction has without aberration.

    For looking up stars on the sky.  First order in beta: aberration itself comes back to 1.1 mas
    (beta^2 / 2), and the length to 1e-8.  Deflection, below 50 mas farther than 9.3 deg from the
    Sun, is left in; so are proper motion and parallax, which belong to the star.
    """
    bx, by, bz = observer[7], observer[8], observer[9]
    stretch = 1.0 + x * bx + y * by + z * bz
    return stretch * x - bx, stretch * y - by, stretch * z - bz


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
        out[s, 0], out[s, 1], out[s, 2] = apparent_place(
            direction[c, 0], direction[c, 1], direction[c, 2],
            motion[c, 0], motion[c, 1], motion[c, 2], parallax[c], observers[frame[s]],
        )  # fmt: skip
