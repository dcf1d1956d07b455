"""Apparent places against ERFA's own chain and against astropy, two paths apart from the kernel."""

from __future__ import annotations

import erfa
import numpy as np
import pytest
from catalog_stars import random_directions, stars
from numpy.typing import NDArray

from stcal.catalog.apparent import Observer, apparent_directions, observer_at
from stcal.catalog.apparent_kernels import geometric_from_apparent
from stcal.catalog.catalogue import StarCatalogue
from stcal.catalog.sphere import motion_vector, unit_vector
from stcal.constants import ARCSEC, DEG, MAS
from stcal.times import julian_date_tt, parse_utc

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# ra, dec [deg], pmra cos dec, pmdec, parallax [mas]: fast and near stars.
BARNARD = (269.452075, 4.693391, -798.58, 10328.12, 546.98)
ALPHA_CEN = (219.902058, -60.833993, -3679.25, 473.67, 754.81)
CYGNI_61 = (316.724797, 38.749417, 4168.31, 3269.20, 285.95)
KAPTEYN = (77.919090, -45.018413, 6505.08, -5730.84, 256.26)
POLE = (37.954561, 89.264109, 44.48, -11.85, 7.54)


def sky(seed: int, n: int) -> Floats:
    """Rows [ra, dec (deg), pmra cos dec, pmdec, parallax (mas)] (n, 5), the fast ones first."""
    rng = np.random.default_rng(seed)
    direction = random_directions(rng, n)
    motion = rng.normal(0.0, 300.0, (2, n))
    # No star faster than 300 km/s, or ERFA's pmsafe puts a distance of its own.
    parallax = np.maximum(rng.exponential(20.0, n), np.hypot(*motion) * 4.74 / 300.0)
    ra = np.arctan2(direction[:, 1], direction[:, 0]) / DEG % 360.0
    rows = np.stack([ra, np.arcsin(direction[:, 2]) / DEG, *motion, parallax], axis=1)
    rows[:5] = BARNARD, ALPHA_CEN, CYGNI_61, KAPTEYN, POLE
    return rows


def catalogue_of(rows: Floats) -> StarCatalogue:
    ra, dec = rows[:, 0] * DEG, rows[:, 1] * DEG
    return stars(
        unit_vector(ra, dec),
        motion=motion_vector(ra, dec, rows[:, 2], rows[:, 3]) * MAS,
        parallax=rows[:, 4] * MAS,
    )


def dates(seed: int, n: int) -> Ints:
    first, last = parse_utc("2013-01-01T00:00:00Z"), parse_utc("2030-12-31T00:00:00Z")
    return np.random.default_rng(seed).integers(first, last, n)


def orbit(seed: int, n: int) -> tuple[Floats, Floats]:
    """Position [km] and velocity [km/s] of low orbits."""
    rng = np.random.default_rng(seed)
    return 7000.0 * random_directions(rng, n), 7.6 * random_directions(rng, n)


UNKNOWN = (np.full((1, 3), np.nan),) * 2


def angle(u: Floats, v: Floats) -> Floats:
    return np.asarray(2.0 * np.arcsin(0.5 * np.linalg.norm(u - v, axis=-1)))


def erfa_places(rows: Floats, t_tai_ns: Ints, state: tuple[Floats, Floats] | None) -> Floats:
    """Apparent directions of star i at time i by erfa.apcs (or apcg) and erfa.atciq."""
    jd = julian_date_tt(t_tai_ns)
    from_sun, from_barycentre = erfa.epv00(*jd)
    pv = np.zeros(len(t_tai_ns), dtype=erfa.dt_pv)
    if state is not None:
        pv["p"], pv["v"] = state[0] * 1e3, state[1] * 1e3
    astrom = erfa.apcs(*jd, pv, from_barycentre, from_sun["p"])
    ra, dec = rows[:, 0] * DEG, rows[:, 1] * DEG
    east = rows[:, 2] * MAS / np.cos(dec)
    found = erfa.atciq(ra, dec, east, rows[:, 3] * MAS, rows[:, 4] * 1e-3, 0.0, astrom)
    return unit_vector(*found)


@pytest.mark.parametrize("in_orbit", [False, True])
def test_against_erfa(in_orbit: bool) -> None:
    n = 3000
    rows, t = sky(1, n), dates(2, n)
    state = orbit(3, n) if in_orbit else None
    observer = observer_at(t, *(state or (np.full((n, 3), np.nan),) * 2))
    found = apparent_directions(catalogue_of(rows), np.arange(n), np.arange(n), observer)
    assert angle(found, erfa_places(rows, t, state)).max() < 1e-5 * MAS


def test_against_erfa_near_the_sun() -> None:
    n = 400
    t = dates(4, n)
    observer = observer_at(t, *(np.full((n, 3), np.nan),) * 2)
    sun = -observer.sun_au / np.linalg.norm(observer.sun_au, axis=1, keepdims=True)
    rng = np.random.default_rng(5)
    # From inside the solar disc (where the deflection is limited) to 5 deg from its centre.
    offset = np.geomspace(1e-4, 5.0, n)[:, None] * DEG
    sideways = np.cross(sun, random_directions(rng, n))
    direction = sun + np.tan(offset) * sideways / np.linalg.norm(sideways, axis=1, keepdims=True)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    rows = np.zeros((n, 5))
    rows[:, 0] = np.arctan2(direction[:, 1], direction[:, 0]) / DEG % 360.0
    rows[:, 1] = np.arcsin(direction[:, 2]) / DEG
    found = apparent_directions(catalogue_of(rows), np.arange(n), np.arange(n), observer)
    assert angle(found, erfa_places(rows, t, None)).max() < 1e-5 * MAS


@pytest.mark.filterwarnings("ignore::erfa.ErfaWarning")
@pytest.mark.parametrize("in_orbit", [False, True])
def test_against_astropy(in_orbit: bool) -> None:
    """ICRS with space motion -> GCRS of the spacecraft, for every star and date."""
    from astropy import units as u
    from astropy.coordinates import GCRS, CartesianRepresentation, SkyCoord
    from astropy.time import Time
    from astropy.utils import iers

    n = 60
    rows, when = sky(6, n), dates(7, 12)
    position, velocity = orbit(8, len(when))
    known = np.ones((len(when), 1)) if in_orbit else np.full((len(when), 1), np.nan)
    observer = observer_at(when, position * known, velocity * known)
    catalogue = catalogue_of(rows)
    worst = np.zeros(n)
    with iers.conf.set_temp("auto_download", False):
        star = SkyCoord(
            ra=rows[:, 0] * u.deg,
            dec=rows[:, 1] * u.deg,
            distance=1000.0 / rows[:, 4] * u.pc,
            pm_ra_cosdec=rows[:, 2] * u.mas / u.yr,
            pm_dec=rows[:, 3] * u.mas / u.yr,
            radial_velocity=np.zeros(n) * u.km / u.s,
            obstime=Time("J2000"),
        )
        for i, t in enumerate(when):
            jd1, jd2 = julian_date_tt(np.array([t]))
            time = Time(jd1[0], jd2[0], format="jd", scale="tt")
            place = {}
            if in_orbit:
                place["obsgeoloc"] = CartesianRepresentation(position[i] * u.km)
                place["obsgeovel"] = CartesianRepresentation(velocity[i] * u.km / u.s)
            moved = star.apply_space_motion(new_obstime=time)
            seen = SkyCoord(moved.ra, moved.dec, moved.distance).transform_to(
                GCRS(obstime=time, **place)
            )
            unit = seen.cartesian.xyz.value.T
            unit = unit / np.linalg.norm(unit, axis=1, keepdims=True)
            found = apparent_directions(catalogue, np.arange(n), np.full(n, i), observer)
            worst = np.maximum(worst, angle(found, unit))
    # Required is 1 mas.  What remains is the Roemer term, which astropy's chain leaves out: 8 min
    # of proper motion, 0.16 mas for Barnard's star.
    assert worst.max() < 0.2 * MAS
    assert worst[5:].max() < 0.02 * MAS


def test_the_size_of_each_effect() -> None:
    t = dates(9, 500)
    nowhere = np.full((500, 3), np.nan)
    still = observer_at(t, nowhere, nowhere)
    moving = observer_at(t, nowhere, np.tile([7.6, 0.0, 0.0], (500, 1)))
    rows = np.array([(0.0, 90.0, 0.0, 0.0, 0.0)])
    pole = catalogue_of(rows)
    at, zero = np.arange(500), np.zeros(500, dtype=int)
    seen = apparent_directions(pole, zero, at, still)
    # Aberration is 20.84 arcsec at perihelion; the pole is 23.4 deg off that of the ecliptic.
    shift = angle(seen, pole.direction) / ARCSEC
    assert 20.9 > shift.max() > 20.6
    assert 19.0 > shift.min() > 18.5
    # 7.6 km/s across the line of sight: 5.23 arcsec.
    extra = angle(apparent_directions(pole, zero, at, moving), seen) / ARCSEC
    np.testing.assert_allclose(extra, 5.229, atol=0.002)


def test_a_state_that_is_half_known_is_used_by_halves() -> None:
    t = dates(10, 2)
    position = np.array([[7000.0, 0.0, 0.0], [np.nan, 0.0, 0.0]])
    velocity = np.array([[np.nan, 7.0, 0.0], [0.0, 7.0, 0.0]])
    centre = observer_at(t, *(np.full((2, 3), np.nan),) * 2)
    found = observer_at(t, position, velocity)
    moved = (found.position_au - centre.position_au) * 149_597_870.7
    np.testing.assert_allclose(moved, [[7000.0, 0.0, 0.0], [0.0, 0.0, 0.0]], atol=1e-4)
    np.testing.assert_allclose(found.sun_au - centre.sun_au, moved / 149_597_870.7, atol=1e-12)
    faster = (found.beta - centre.beta) * 299_792.458
    np.testing.assert_allclose(faster, [[0.0, 0.0, 0.0], [0.0, 7.0, 0.0]], atol=1e-9)


def test_the_rows_that_kernels_read() -> None:
    observer = observer_at(dates(11, 4), *orbit(12, 4))
    rows = observer.rows
    assert rows.shape == (4, 13)
    assert rows.flags.c_contiguous
    assert 13.0 < rows[0, 0] < 31.0
    np.testing.assert_array_equal(rows[:, 1:4], observer.position_au)
    sun_au = np.linalg.norm(observer.sun_au, axis=1)
    np.testing.assert_allclose(rows[:, 4:7] * sun_au[:, None], observer.sun_au, rtol=1e-15)
    np.testing.assert_array_equal(rows[:, 7:10], observer.beta)
    assert observer.rows is rows


def test_a_frame_has_the_same_observer_in_any_company() -> None:
    t, state = dates(22, 200), orbit(23, 200)
    together = observer_at(t, *state).rows
    alone = np.concatenate(
        [
            observer_at(t[i : i + 1], state[0][i : i + 1], state[1][i : i + 1]).rows
            for i in range(200)
        ]
    )
    np.testing.assert_array_equal(together, alone)


def test_years_count_from_j2000() -> None:
    # 2000-01-01T12:00:00 TT is 11:58:55.816 UTC.
    observer = observer_at(np.array([parse_utc("2000-01-01T11:58:55.816Z")]), *UNKNOWN)
    assert observer.years[0] == pytest.approx(0.0, abs=1e-12)


def without_aberration(u: Floats, observer: Observer) -> Floats:
    out = np.empty_like(u)
    for i, row in enumerate(observer.rows):
        out[i] = geometric_from_apparent(*u[i], row)
    return out / np.linalg.norm(out, axis=1, keepdims=True)


def test_aberration_comes_back_within_2_mas() -> None:
    n = 2000
    observer = observer_at(dates(13, n), *orbit(14, n))
    direction = random_directions(np.random.default_rng(15), n)
    speed2 = np.sum(observer.beta**2, axis=1)
    sun = np.linalg.norm(observer.sun_au, axis=1)
    seen = erfa.ab(direction, observer.beta, sun, np.sqrt(1.0 - speed2))
    assert angle(seen, direction).max() > 20.0 * ARCSEC
    assert angle(without_aberration(seen, observer), direction).max() < 2.0 * MAS


def test_a_look_up_finds_the_star_within_50_mas_away_from_the_sun() -> None:
    n = 2000
    observer = observer_at(dates(16, n), *orbit(17, n))
    direction = random_directions(np.random.default_rng(18), n)
    sun = -observer.sun_au / np.linalg.norm(observer.sun_au, axis=1, keepdims=True)
    away = angle(direction, sun) > 10.0 * DEG
    seen = apparent_directions(stars(direction), np.arange(n), np.arange(n), observer)
    off = angle(without_aberration(seen, observer), direction)
    assert off[away].max() < 0.05 * ARCSEC


def test_indices_outside_are_refused() -> None:
    observer = observer_at(dates(19, 2), *orbit(20, 2))
    catalogue = catalogue_of(sky(21, 6))
    for star, frame in (([6], [0]), ([-1], [0]), ([0], [2]), ([0], [-1])):
        with pytest.raises(IndexError):
            apparent_directions(catalogue, np.array(star), np.array(frame), observer)
    nothing = np.zeros(0, dtype=int)
    assert apparent_directions(catalogue, nothing, nothing, observer).shape == (0, 3)
