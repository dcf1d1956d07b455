"""Apparent directions of catalogue stars at a frame's time and from the spacecraft.

Proper motion to the epoch, parallax, light deflection by the Sun and aberration by the Earth's
barycentric velocity plus the spacecraft's own where telemetry has it.  Agrees with ERFA's atciq to
1e-5 mas and with astropy's ICRS to GCRS to 0.02 mas (0.2 mas for the fastest stars).  Not modelled:
deflection by the Earth and the planets (the Earth's is below 0.6 mas), and radial velocity, which
the catalogues lack: at 50 km/s it moves the nearest stars by 0.14 arcsec (0.7 urad) in 30 years,
and all but some 300 of the bundled 46,132 by less than 1 mas.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import erfa
import numpy as np
from numpy.typing import NDArray

from stcal.catalog.catalogue import StarCatalogue
from stcal.constants import AU_M, DAY_S, SPEED_OF_LIGHT_M_S
from stcal.times import julian_date_tt

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_J2000_JD = 2_451_545.0
_DAYS_PER_YEAR = 365.25
_HOUR_NS = 3_600_000_000_000
# Schwarzschild radius of the Sun in au: 2 * 1.32712440041e20 / (c^2 au) (SOFA's SRS).
_SUN_SCHWARZSCHILD_AU = 1.97412574336e-8
# Smallest q.(q + e) of the deflection formula: inside about 0.08 deg of the Sun's centre the
# deflection is held down instead of growing without limit (SOFA's ldsun).
_DEFLECTION_LIMIT = 1e-6
_AU_PER_DAY_IN_C = AU_M / DAY_S / SPEED_OF_LIGHT_M_S


@dataclass(frozen=True)
class Observer:
    """Where frames were taken from, ICRS axes.

    Attributes
    ----------
    years : (F,) Julian years of TT since J2000.0
    position_au : (F, 3) from the solar system's barycentre
    sun_au : (F, 3) from the Sun to the observer
    beta : (F, 3) barycentric velocity over the speed of light
    """

    years: Floats
    position_au: Floats
    sun_au: Floats
    beta: Floats

    @cached_property
    def rows(self) -> Floats:
        """(F, 13) C-contiguous, for the kernels.

        Columns: years; position_au (3); unit vector from the Sun to the observer (3); beta (3);
        sqrt(1 - beta^2); strength of the Sun's deflection; floor of its denominator.
        """
        sun_au = np.linalg.norm(self.sun_au, axis=1)
        columns = (
            self.years,
            *self.position_au.T,
            *(self.sun_au / sun_au[:, None]).T,
            *self.beta.T,
            np.sqrt(1.0 - np.sum(self.beta**2, axis=1)),
            _SUN_SCHWARZSCHILD_AU / sun_au,
            _DEFLECTION_LIMIT / np.maximum(sun_au**2, 1.0),
        )
        return np.stack(columns, axis=1, dtype=np.float64)


def observer_at(t_tai_ns: Ints, pos_km: Floats, vel_km_s: Floats) -> Observer:
    """Return the observer at frame times (F,).

    The Earth comes from ERFA's epv00 (11 km, 5 mm/s against DE405; TT stands in for TDB, which
    differs by under 2 ms).  ``pos_km`` and ``vel_km_s`` (F, 3) are the spacecraft's geocentric
    state; where one of them is not finite the geocentre's stands in for it.
    """
    t_tai_ns = np.asarray(t_tai_ns, dtype=np.int64)
    jd1, jd2 = julian_date_tt(t_tai_ns)
    from_sun, from_barycentre, earth_beta = _earth(t_tai_ns)
    offset_au = _finite_rows(pos_km) * (1e3 / AU_M)
    offset_beta = _finite_rows(vel_km_s) * (1e3 / SPEED_OF_LIGHT_M_S)
    return Observer(
        years=((jd1 - _J2000_JD) + jd2) / _DAYS_PER_YEAR,
        position_au=from_barycentre + offset_au,
        sun_au=from_sun + offset_au,
        beta=earth_beta + offset_beta,
    )


def _earth(t_tai_ns: Ints) -> tuple[Floats, Floats, Floats]:
    """Return the Earth from the Sun and from the barycentre (F, 3) [au], and its velocity / c.

    epv00 costs some 20 us, so it is evaluated on whole hours and interpolated by cubic Hermite
    polynomials, which adds under 1e-5 m/s and 1 cm; the hours are absolute, so that a frame's
    answer doesn't depend on its neighbours.
    """
    hours, rest = np.divmod(t_tai_ns, _HOUR_NS)
    nodes, where = np.unique(np.concatenate([hours, hours + 1]), return_inverse=True)
    from_sun, from_barycentre = erfa.epv00(*julian_date_tt(nodes * _HOUR_NS))
    first, second = where[: len(hours)], where[len(hours) :]
    x = (rest / _HOUR_NS)[:, None]
    sun, _ = _hermite(from_sun, first, second, x)
    barycentre, velocity = _hermite(from_barycentre, first, second, x)
    return sun, barycentre, velocity * _AU_PER_DAY_IN_C


def _hermite(state: Any, first: Ints, second: Ints, x: Floats) -> tuple[Floats, Floats]:
    """Interpolate position [au] and its derivative [au/day] between nodes an hour apart."""
    step = 1.0 / 24.0
    p0, p1 = state["p"][first], state["p"][second]
    v0, v1 = step * state["v"][first], step * state["v"][second]
    chord = p1 - p0
    cubic = v0 + v1 - 2.0 * chord
    square = chord - v0 - cubic
    position = p0 + x * (v0 + x * (square + x * cubic))
    velocity = (v0 + x * (2.0 * square + x * 3.0 * cubic)) / step
    return position, velocity


def _finite_rows(vectors: Floats) -> Floats:
    """Return the vectors (F, 3) with every row that is not finite set to zero."""
    known = np.isfinite(vectors).all(axis=1, keepdims=True)
    return np.where(known, vectors, 0.0)


def apparent_directions(
    catalogue: StarCatalogue, star: Ints, frame: Ints, observer: Observer
) -> Floats:
    """Return apparent unit directions (S, 3) in I of catalogue rows ``star`` in frames ``frame``.

    ``star`` (S,) indexes the catalogue, ``frame`` (S,) the observer.

    Raises
    ------
    IndexError
        When an index lies outside (kernels do not check).
    """
    from stcal.catalog.apparent_kernels import apparent_places

    star = np.ascontiguousarray(star, dtype=np.int64)
    frame = np.ascontiguousarray(frame, dtype=np.int64)
    _check_index(star, len(catalogue.star_id), "star")
    _check_index(frame, len(observer.years), "frame")
    out = np.empty((len(star), 3))
    apparent_places(
        catalogue.direction, catalogue.motion, catalogue.parallax, star, frame, observer.rows, out
    )
    return out


def _check_index(index: Ints, size: int, name: str) -> None:
    if len(index) and (index.min() < 0 or index.max() >= size):
        raise IndexError(f"{name} index outside 0..{size - 1}")
