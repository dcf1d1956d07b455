"""Circular orbits with the secular drift of J2, and where the Sun and the Moon stand."""

from __future__ import annotations

from dataclasses import dataclass

import erfa
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stcal.catalog.apparent import observer_at
from stcal.constants import DAY_S, DEG, EARTH_GM_M3_S2, EARTH_J2, EARTH_RADIUS_M
from stcal.simulate.sections import OrbitSection
from stcal.times import julian_date_tt

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_J2000_JD = 2_451_545.0


@dataclass(frozen=True)
class Orbit:
    """A circular orbit whose node and argument of latitude drift linearly.

    The Earth's equator of J2000.0 stands for the equator of date (precession is 0.14 degree in
    25 years).  ``raan`` and ``phase`` are at time 0 of ``t_s``.
    """

    radius_m: float
    inclination: float
    raan: float
    raan_rate: float
    phase: float
    phase_rate: float

    @property
    def nodal_period_s(self) -> float:
        """Time from ascending node to ascending node."""
        return float(2.0 * np.pi / self.phase_rate)


def orbit_from(section: OrbitSection, epoch_tai_ns: int) -> Orbit:
    """Return the orbit of a scenario, time 0 at its epoch.

    Secular J2 rates of a circular orbit, Vallado 2013 section 9.6.1 with e = 0: the argument of
    latitude carries the drift of the perigee and of the mean anomaly.
    """
    radius = EARTH_RADIUS_M + section.altitude_km * 1e3
    inclination = section.inclination_deg * DEG
    motion = np.sqrt(EARTH_GM_M3_S2 / radius**3)
    j2 = 1.5 * EARTH_J2 * (EARTH_RADIUS_M / radius) ** 2
    if section.raan_deg is not None:
        raan = section.raan_deg * DEG
    else:
        assert section.ltan_h is not None  # validated: one of the two
        raan = mean_sun_right_ascension(epoch_tai_ns) + (section.ltan_h - 12.0) * 15.0 * DEG
    return Orbit(
        radius_m=radius,
        inclination=inclination,
        raan=raan,
        raan_rate=float(-j2 * motion * np.cos(inclination)),
        phase=section.phase_deg * DEG,
        phase_rate=float(motion * (1.0 + j2 * (3.0 - 4.0 * np.sin(inclination) ** 2))),
    )


def mean_sun_right_ascension(t_tai_ns: int) -> float:
    """Return the right ascension [rad] of the fictitious mean Sun (Astronomical Almanac C5)."""
    jd1, jd2 = julian_date_tt(np.array([t_tai_ns], dtype=np.int64))
    days = float(jd1[0] - _J2000_JD + jd2[0])
    return float((280.460 + 0.985_647_4 * days) % 360.0) * DEG


def local_frame(orbit: Orbit, t_s: Floats) -> tuple[Rotation, Floats]:
    """Return the rotations L -> I of the local frame and its rate (T, 3) [rad/s] in I.

    L: x radial outwards, y along the track, z the orbit's normal.  C_IL = Rz(raan) Rx(i) Rz(u).
    """
    raan = orbit.raan + orbit.raan_rate * t_s
    u = orbit.phase + orbit.phase_rate * t_s
    angles = np.stack([raan, np.full_like(u, orbit.inclination), u], axis=-1)
    c_il = Rotation.from_euler("ZXZ", angles)
    normal = c_il.as_matrix()[:, :, 2]
    rate = orbit.phase_rate * normal
    rate[:, 2] += orbit.raan_rate
    return c_il, rate


def state(orbit: Orbit, t_s: Floats) -> tuple[Floats, Floats]:
    """Return position (T, 3) [km] and velocity (T, 3) [km/s], geocentric, ICRF axes."""
    c_il, rate = local_frame(orbit, t_s)
    position = orbit.radius_m * 1e-3 * c_il.as_matrix()[:, :, 0]
    return position, np.cross(rate, position)


def sun_and_moon(t_tai_ns: Ints) -> tuple[Floats, Floats]:
    """Return unit vectors (T, 3) from the geocentre to the Sun and to the Moon (ERFA)."""
    centre = np.zeros((len(t_tai_ns), 3))
    earth = observer_at(t_tai_ns, centre, centre)
    moon = erfa.moon98(*julian_date_tt(t_tai_ns))["p"]
    return _unit(-earth.sun_au), _unit(moon)


def _unit(v: Floats) -> Floats:
    return np.asarray(v / np.linalg.norm(v, axis=1)[:, None])


def in_shadow(position_km: Floats, sun: Floats) -> NDArray[np.bool_]:
    """(T,) whether the Earth hides the Sun: a cylindrical shadow."""
    along = np.einsum("ti,ti->t", position_km, sun)
    across2 = np.einsum("ti,ti->t", position_km, position_km) - along**2
    return np.asarray((along < 0) & (across2 < (EARTH_RADIUS_M * 1e-3) ** 2))


SUN_SYNCHRONOUS_RATE = 2.0 * np.pi / (365.2422 * DAY_S)
"""Rate of the node [rad/s] that keeps its local time: one turn a tropical year."""
