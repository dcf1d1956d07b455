"""Orbits against closed forms and a numerically integrated J2 field."""

import erfa
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from stcal.constants import DAY_S, DEG, EARTH_GM_M3_S2, EARTH_J2, EARTH_RADIUS_M
from stcal.simulate.orbit import (
    SUN_SYNCHRONOUS_RATE,
    in_shadow,
    orbit_from,
    state,
    sun_and_moon,
)
from stcal.simulate.sections import OrbitSection
from stcal.times import julian_date_tt, parse_utc

EPOCH = parse_utc("2014-02-10T06:00:00Z")


def _orbit(**changes):
    section = {"altitude_km": 570.0, "inclination_deg": 97.8, "raan_deg": 40.0, "phase_deg": 25.0}
    return orbit_from(OrbitSection(**(section | changes)), EPOCH)


def test_period_without_nodal_drift_is_keplers():
    # At sin^2 i = 3/4 the J2 terms of perigee and mean anomaly cancel.
    orbit = _orbit(inclination_deg=60.0)
    radius = EARTH_RADIUS_M + 570e3
    kepler = 2 * np.pi * np.sqrt(radius**3 / EARTH_GM_M3_S2)
    assert orbit.nodal_period_s == pytest.approx(kepler, rel=1e-12)
    assert kepler == pytest.approx(96.06 * 60.0, abs=1.0)


def test_radius_inclination_and_node():
    orbit = _orbit()
    t = np.linspace(0.0, 5000.0, 200)
    position, velocity = state(orbit, t)
    radius = np.linalg.norm(position, axis=1)
    np.testing.assert_allclose(radius, EARTH_RADIUS_M * 1e-3 + 570.0, rtol=1e-12)
    normal = np.cross(position, velocity)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    np.testing.assert_allclose(np.degrees(np.arccos(normal[:, 2])), 97.8, atol=0.02)
    latitude = np.arcsin(position[:, 2] / radius)
    assert latitude.max() == pytest.approx((180.0 - 97.8) * DEG, abs=1e-3)
    # Phase 25 degrees after the node at 40 degrees of right ascension.
    first = position[0] / radius[0]
    assert first[2] == pytest.approx(np.sin(25 * DEG) * np.sin(97.8 * DEG))
    node = np.array([np.cos(40 * DEG), np.sin(40 * DEG), 0.0])
    assert first @ node == pytest.approx(np.cos(25 * DEG))


def test_velocity_is_the_derivative_of_position():
    orbit = _orbit()
    t, h = np.linspace(0.0, 90_000.0, 50), 0.5
    difference = (state(orbit, t + h)[0] - state(orbit, t - h)[0]) / (2 * h)
    np.testing.assert_allclose(state(orbit, t)[1], difference, atol=2e-6)


@pytest.mark.parametrize(("altitude", "inclination"), [(600.0, 97.79), (800.0, 98.60)])
def test_published_sun_synchronous_inclinations_follow_the_sun(altitude, inclination):
    orbit = _orbit(altitude_km=altitude, inclination_deg=inclination)
    assert orbit.raan_rate == pytest.approx(SUN_SYNCHRONOUS_RATE, rel=2e-3)
    assert pytest.approx(0.98565, abs=1e-5) == SUN_SYNCHRONOUS_RATE * DAY_S / DEG


def _j2_acceleration(_, y):
    r = y[:3]
    length = np.linalg.norm(r)
    factor = 1.5 * EARTH_J2 * (EARTH_RADIUS_M / length) ** 2
    z2 = 5.0 * (r[2] / length) ** 2
    scale = np.array([1 - factor * (z2 - 1), 1 - factor * (z2 - 1), 1 - factor * (z2 - 3)])
    return np.concatenate([y[3:], -EARTH_GM_M3_S2 * r / length**3 * scale])


def test_node_drifts_as_in_an_integrated_j2_field():
    orbit = _orbit(inclination_deg=70.0)
    position, velocity = state(orbit, np.zeros(1))
    start = np.concatenate([position[0], velocity[0]]) * 1e3
    span = 15 * orbit.nodal_period_s
    end = solve_ivp(_j2_acceleration, (0.0, span), start, rtol=1e-10, atol=1e-4).y[:, -1]
    normal = np.cross(end[:3], end[3:])
    node = np.arctan2(normal[0], -normal[1])
    drift = (node - orbit.raan + np.pi) % (2 * np.pi) - np.pi
    assert drift == pytest.approx(orbit.raan_rate * span, rel=0.01)
    # The osculating start differs from mean elements by a few J2, which mean motion feels.
    u = np.arctan2(end[2] / np.sin(70 * DEG), end[0] * np.cos(node) + end[1] * np.sin(node))
    lag = (u - orbit.phase - orbit.phase_rate * span + np.pi) % (2 * np.pi) - np.pi
    assert abs(lag) < 5e-3 * orbit.phase_rate * span


@pytest.mark.parametrize("ltan", [6.0, 10.5, 22.5])
def test_local_time_of_the_node(ltan):
    orbit = _orbit(raan_deg=None, ltan_h=ltan)
    sun, _ = sun_and_moon(np.array([EPOCH]))
    right_ascension = np.arctan2(sun[0, 1], sun[0, 0])
    hours = ((orbit.raan - right_ascension) / (15 * DEG) + 12.0) % 24.0
    assert hours == pytest.approx(ltan, abs=0.3)  # the equation of time is below 0.28 h


def test_sun_and_moon_against_other_series():
    times = EPOCH + np.arange(0, 300, 30) * 86_400_000_000_000
    sun, moon = sun_and_moon(times)
    days = sum(julian_date_tt(times)) - 2_451_545.0
    # Meeus 1998 chapter 25: low-precision Sun, of date; precession in 14 years is 0.2 degree.
    mean, anomaly = 280.466 + 0.985_647_36 * days, (357.529 + 0.985_600_28 * days) * DEG
    longitude = (mean + 1.915 * np.sin(anomaly) + 0.020 * np.sin(2 * anomaly)) * DEG
    slant = 23.436 * DEG
    low = np.stack(
        [np.cos(longitude), np.sin(longitude) * np.cos(slant), np.sin(longitude) * np.sin(slant)],
        axis=1,
    )
    assert np.degrees(np.arccos(np.einsum("ti,ti->t", sun, low))).max() < 0.3
    ecliptic = moon @ erfa.ecm06(2_451_545.0, 0.0).T
    assert np.degrees(np.arcsin(np.abs(ecliptic[:, 2]))).max() < 5.4
    assert np.ptp(ecliptic[:, 2]) > 0.05


def test_shadow_covers_the_closed_form_share_of_a_noon_orbit():
    sun, _ = sun_and_moon(np.array([EPOCH]))
    raan = np.degrees(np.arctan2(sun[0, 1], sun[0, 0]))
    orbit = _orbit(inclination_deg=90.0, raan_deg=float(raan))
    t = np.linspace(0.0, orbit.nodal_period_s, 20_001)[:-1]
    position, _ = state(orbit, t)
    share = in_shadow(position, np.broadcast_to(sun, position.shape)).mean()
    half = np.arcsin(EARTH_RADIUS_M / orbit.radius_m)
    assert share == pytest.approx(half / np.pi, abs=2e-3)
    # The sunlit side isn't in shadow.
    assert not in_shadow(sun * 7000.0, sun).any()
    assert in_shadow(-sun * 7000.0, sun).all()
