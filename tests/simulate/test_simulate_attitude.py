"""Spacecraft motions: geometry, continuity, and rates against finite differences."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stcal.constants import DEG
from stcal.simulate import attitude
from stcal.simulate.orbit import orbit_from, state
from stcal.simulate.sections import CoarseHold, Mounting, NadirPointing, OrbitSection, Slew
from stcal.times import parse_utc

ORBIT = orbit_from(
    OrbitSection(altitude_km=570.0, inclination_deg=97.8, raan_deg=40.0),
    parse_utc("2014-02-10T06:00:00Z"),
)
TARGET = (60.0, 20.0, 15.0)
MOTIONS = {
    "nadir": NadirPointing(motion="nadir-pointing", frames=1, offset_deg=(20.0, -5.0, 3.0)),
    "slew": Slew(
        motion="slew", frames=1, rate_deg_s=0.3, axis_b=(1.0, 2.0, -0.5), target_deg=TARGET
    ),
    "hold": CoarseHold(motion="coarse-hold", frames=1, target_deg=TARGET),
}
C_BS = attitude.mounting_rotation(Mounting(boresight_b=(0.3, -0.7, -0.5), roll_deg=33.0))


def _motion(segment, wander_deg=0.0, period=300.0, before=None, seed=4):
    segment = segment.model_copy(update={"wander_deg": wander_deg, "wander_period_s": period})
    wander = attitude.draw_wander(segment, np.random.default_rng(seed))
    return attitude.motion_of(segment, 100.0, before, C_BS, wander)


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("wander_deg", [0.0, 5.0])
def test_rates_agree_with_finite_differences(name, wander_deg):
    motion = _motion(MOTIONS[name], wander_deg)
    t, h = np.linspace(100.0, 4000.0, 80), 0.01
    _, rate = attitude.attitude_at(motion, ORBIT, t)
    before, _ = attitude.attitude_at(motion, ORBIT, t - h)
    after, _ = attitude.attitude_at(motion, ORBIT, t + h)
    # A turn of B by v in its own axes multiplies c_ib from the right.
    difference = (before.inv() * after).as_rotvec() / (2 * h)
    np.testing.assert_allclose(rate, difference, atol=2e-8)
    if wander_deg:
        assert np.abs(rate).max() > 1e-4


def test_nadir_pointing_looks_down_and_along_the_track():
    segment = NadirPointing(motion="nadir-pointing", frames=1)
    t = np.linspace(0.0, 20_000.0, 300)
    c_ib, rate = attitude.attitude_at(_motion(segment), ORBIT, t)
    position, velocity = state(ORBIT, t)
    down = -position / np.linalg.norm(position, axis=1)[:, None]
    along = velocity / np.linalg.norm(velocity, axis=1)[:, None]
    normal = np.cross(position, velocity)
    np.testing.assert_allclose(c_ib.apply([0.0, 0.0, 1.0]), down, atol=1e-12)
    np.testing.assert_allclose(c_ib.apply([1.0, 0.0, 0.0]), along, atol=2e-4)  # node drift
    assert (np.einsum("ti,ti->t", c_ib.apply([0.0, 1.0, 0.0]), normal) < 0).all()
    np.testing.assert_allclose(rate[:, 1], -ORBIT.phase_rate, rtol=2e-4)


def test_offset_turns_the_body_about_x_then_y():
    t = np.array([1234.0])
    plain, _ = attitude.attitude_at(
        _motion(NadirPointing(motion="nadir-pointing", frames=1)), ORBIT, t
    )
    turned, _ = attitude.attitude_at(
        _motion(NadirPointing(motion="nadir-pointing", frames=1, offset_deg=(30.0, 0.0, 0.0))),
        ORBIT,
        t,
    )
    z = (plain.inv() * turned).apply([0.0, 0.0, 1.0])[0]
    np.testing.assert_allclose(z, [0.0, -0.5, np.sqrt(0.75)], atol=1e-12)


@pytest.mark.parametrize("boresight", [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.2, -0.9, 0.4)])
def test_mounting(boresight):
    c_bs = attitude.mounting_rotation(Mounting(boresight_b=boresight, roll_deg=0.0))
    unit = np.array(boresight) / np.linalg.norm(boresight)
    np.testing.assert_allclose(c_bs.apply([0.0, 0.0, 1.0]), unit, atol=1e-14)
    rolled = attitude.mounting_rotation(Mounting(boresight_b=boresight, roll_deg=90.0))
    np.testing.assert_allclose(rolled.apply([1, 0, 0]), c_bs.apply([0, 1, 0]), atol=1e-14)
    assert np.linalg.det(c_bs.as_matrix()) == pytest.approx(1.0)


def test_target_is_where_it_says():
    c_is = attitude.target_rotation((60.0, 20.0, 0.0))
    ra, dec = 60 * DEG, 20 * DEG
    z = [np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)]
    np.testing.assert_allclose(c_is.apply([0, 0, 1]), z, atol=1e-14)
    north, east = c_is.apply([1, 0, 0]), attitude.target_rotation((60.0, 20.0, 90.0))
    assert north[2] > 0.9
    np.testing.assert_allclose(east.apply([1, 0, 0]), [-np.sin(ra), np.cos(ra), 0], atol=1e-14)
    hold, _ = attitude.attitude_at(_motion(MOTIONS["hold"]), ORBIT, np.array([100.0]))
    expected = attitude.target_rotation(TARGET)
    assert ((hold * C_BS).inv() * expected).magnitude()[0] < 1e-12


def test_motion_without_a_target_goes_on_from_the_attitude_before():
    before = Rotation.from_rotvec([0.3, -1.0, 2.0])
    segment = Slew(motion="slew", frames=1, rate_deg_s=0.2, axis_b=(0.0, 0.0, 1.0))
    motion = _motion(segment, wander_deg=3.0, before=before)
    c_ib, _ = attitude.attitude_at(motion, ORBIT, np.array([100.0]))
    assert (before.inv() * c_ib).magnitude()[0] < 1e-12


def test_slew_turns_at_its_rate_about_its_axis():
    motion = _motion(MOTIONS["slew"])
    c_ib, rate = attitude.attitude_at(motion, ORBIT, np.array([100.0, 200.0]))
    turned = (c_ib[0].inv() * c_ib[1]).as_rotvec()
    axis = np.array([1.0, 2.0, -0.5]) / np.linalg.norm([1.0, 2.0, -0.5])
    np.testing.assert_allclose(turned, 30.0 * DEG * axis, atol=1e-12)
    np.testing.assert_allclose(rate, [0.3 * DEG * axis] * 2, atol=1e-15)


def test_wander_has_its_rms():
    t = np.arange(100.0, 400_000.0, 37.0)
    c_ib, _ = attitude.attitude_at(_motion(MOTIONS["hold"], 2.0), ORBIT, t)
    still, _ = attitude.attitude_at(_motion(MOTIONS["hold"]), ORBIT, t)
    away = (still.inv() * c_ib).as_rotvec() / DEG
    np.testing.assert_allclose(np.sqrt((away**2).mean(axis=0)), 2.0, rtol=0.05)
