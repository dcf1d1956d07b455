"""Stars of an exposure that neither noise nor the camera's uncertainty explains."""

import numpy as np
import pytest
from conftest import ROOT
from scipy.spatial.transform import Rotation

from stcal.cameras import CAMERAS, Camera
from stcal.matching.verify_kernels import refine_attitude
from stcal.residuals.screening_kernels import (
    _attitude_follows,
    _attitude_normal,
    _camera_part,
    _invert,
    _noise_part,
    screen_exposure,
)
from stcal.simulate import load_scenario

NAMES = CAMERAS["wang"].parameter_names
SIGMA = np.array([8e-6, 30.0, 30.0, 1e8, 1e3, 0.01, 0.01, 2e-4])
# A camera known to some hundredths of a sigma, and one straight from the laboratory.
KNOWN, UNKNOWN = np.eye(8) * 1e-6, np.eye(8) * 100.0


class Exposure:
    """Stars over the detector of a true camera, with noise of 0.3 to 0.7 px."""

    def __init__(self, stars, seed):
        self.rng = np.random.default_rng(seed)
        x = np.array([0.016, 980.0, 1250.0, 1.4e8, -1.2e3, 0.05, 0.02, 1.0008])
        self.camera = Camera(CAMERAS["wang"], 1944, 2592, 2.2e-6, x)
        self.m = self.rng.uniform(50, 1890, stars)
        self.n = self.rng.uniform(50, 2540, stars)
        self.sd_px = self.rng.uniform(0.3, 0.7, stars)
        self.s, by_parameter, _ = self.camera.jacobian(self.m, self.n)
        self.by_state = np.ascontiguousarray(by_parameter * SIGMA)
        self.sd = self.sd_px * self.camera.noise_scale(self.m, self.n)
        self.c = Rotation.from_rotvec([0.3, -0.8, 0.4]).as_matrix()
        self.s_i = np.ascontiguousarray(self.s @ self.c)

    def seen(self, gross_px=0.0):
        """Star vectors of noisy centroids, ``gross_px`` in rows added."""
        m, n = (v + self.sd_px * self.rng.normal(size=len(v)) for v in (self.m, self.n))
        return self.camera.directions(m + gross_px, n)

    def screen(self, s, covariance, sigma=5.0, scale=1.0):
        kept = np.ones(len(s), bool)
        left = screen_exposure(
            s, self.s_i, self.sd, self.by_state, covariance, scale, sigma, self.c.copy(), kept
        )
        assert left == kept.sum()
        return kept


@pytest.mark.parametrize("stars", [5, 9, 20])
def test_a_gross_centroid_is_rejected_when_the_camera_is_known(stars):
    for seed in range(20):
        exposure = Exposure(stars, seed)
        gross = np.zeros(stars)
        gross[seed % stars] = 25.0
        kept = exposure.screen(exposure.seen(gross_px=gross), KNOWN)
        assert np.array_equal(np.flatnonzero(~kept), [seed % stars])


def test_several_gross_centroids_are_rejected_one_at_a_time():
    """The worst bends the attitude that judges its neighbours: they are judged anew without it."""
    for seed in range(10):
        exposure = Exposure(14, seed)
        gross = np.zeros(14)
        gross[[2, 7, 11]] = 400.0, 60.0, -20.0
        kept = exposure.screen(exposure.seen(gross_px=gross), KNOWN)
        assert np.array_equal(np.flatnonzero(~kept), [2, 7, 11])


@pytest.mark.parametrize("number", [1, 2, 3, 4, 5, 6])
def test_what_the_cameras_uncertainty_explains_is_kept(number):
    """A camera off as those of Table III moves stars by many times the noise: no outliers."""
    scenario = load_scenario(ROOT / "configs" / "scenarios" / f"st16-{number}.toml")
    offset = np.array([scenario.camera.offset_sigma[name] for name in NAMES])
    far = 0
    for seed in range(20):
        exposure = Exposure(12, seed)
        true = exposure.camera.parameters + offset * SIGMA
        true = exposure.camera.with_parameters(true)
        exposure.s_i = np.ascontiguousarray(true.directions(exposure.m, exposure.n) @ exposure.c)
        s = exposure.seen()
        assert exposure.screen(s, UNKNOWN).all()
        far += (~exposure.screen(s, KNOWN)).sum()
    assert far > 20


def test_a_false_star_is_rejected_even_when_the_camera_is_unknown():
    """The camera's uncertainty bends the field smoothly, and not by any amount."""
    exposure = Exposure(12, 3)
    gross = np.zeros(12)
    gross[4] = 1500.0
    kept = exposure.screen(exposure.seen(gross_px=gross), 0.01 * UNKNOWN)
    assert not kept[4]
    assert kept.sum() >= 10


@pytest.mark.parametrize("stars", [4, 6, 15])
def test_clean_stars_pass_at_five_sigma(stars):
    """exp(-12.5) of them lie beyond 5 sigma per axis: 0.04 expected in 10000."""
    exposures = [Exposure(stars, seed) for seed in range(10000 // stars)]
    rejected = sum((~e.screen(e.seen(), KNOWN)).sum() for e in exposures)
    assert rejected <= 1


def test_the_rate_at_a_low_limit_is_rayleighs():
    """Beyond 3.3 sigma lie exp(-5.4) of the stars, so the worst of 15 in 6.3 % of exposures."""
    hit, trials = 0, 600
    for seed in range(trials):
        exposure = Exposure(15, seed)
        hit += not exposure.screen(exposure.seen(), KNOWN, sigma=3.3).all()
    expected = 1.0 - (1.0 - np.exp(-0.5 * 3.3**2)) ** 15
    assert hit / trials == pytest.approx(expected, abs=4.0 * np.sqrt(expected / trials))


def test_the_noise_that_the_filter_has_found_widens_the_limit():
    exposure = Exposure(10, 5)
    gross = np.zeros(10)
    gross[3] = 6.0
    s = exposure.seen(gross_px=gross)
    assert not exposure.screen(s, KNOWN)[3]
    assert exposure.screen(s, KNOWN, scale=4.0).all()


def test_three_stars_are_the_least():
    exposure = Exposure(4, 6)
    gross = np.array([0.0, 300.0, -500.0, 700.0])
    kept = exposure.screen(exposure.seen(gross_px=gross), KNOWN)
    assert kept.sum() >= 2
    two = Exposure(2, 6)
    assert two.screen(two.seen(gross_px=np.array([0.0, 50.0])), KNOWN).all()


def residuals(exposure, s):
    """Departures (N, 3) from the unweighted attitude of star vectors."""
    c = exposure.c.copy()
    assert refine_attitude(s, exposure.s_i, np.zeros(len(s), np.int32), c)
    return s - exposure.s_i @ c.T


def geometry(exposure):
    normal, middle, inverse = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    kept = np.ones(len(exposure.s), bool)
    _attitude_normal(exposure.s, exposure.sd, kept, normal, middle)
    assert _invert(normal, inverse)
    np.testing.assert_allclose(inverse @ normal, np.eye(3), atol=1e-12)
    return inverse, middle, kept


@pytest.mark.parametrize("stars", [4, 6, 20])
def test_the_noise_part_is_what_a_monte_carlo_gives(stars):
    exposure = Exposure(stars, 7)
    inverse, middle, _ = geometry(exposure)
    found = [_noise_part(s, sd, inverse, middle)
             for s, sd in zip(exposure.s, exposure.sd, strict=True)]  # fmt: skip
    trials = 6000
    total = np.zeros(stars)
    for _ in range(trials):
        turn = exposure.sd[:, None] * exposure.rng.normal(size=(stars, 3))
        turn -= exposure.s * np.einsum("ki,ki->k", turn, exposure.s)[:, None]
        s = exposure.s + turn
        s /= np.linalg.norm(s, axis=1)[:, None]
        total += (residuals(exposure, s) ** 2).sum(axis=1)
    # The mean of 2-degree chi-squares spreads by 1 / sqrt(trials), 1.3 %.
    floor = 2.0 * exposure.sd**2 * 0.1
    free = np.array(found) > 1.0001 * floor
    assert free.sum() >= stars - 1
    np.testing.assert_allclose((total / trials / found)[free], 1.0, atol=0.06)


@pytest.mark.parametrize("stars", [5, 20])
def test_the_cameras_part_is_what_a_monte_carlo_gives(stars):
    exposure = Exposure(stars, 8)
    inverse, _, kept = geometry(exposure)
    rng = exposure.rng
    root = 0.02 * rng.normal(size=(8, 8))
    covariance = root @ root.T
    turn = _attitude_follows(exposure.s, exposure.by_state, kept, inverse)
    found = [_camera_part(s, by, turn, covariance)
             for s, by in zip(exposure.s, exposure.by_state, strict=True)]  # fmt: skip
    trials = 3000
    total = np.zeros(stars)
    for _ in range(trials):
        x = exposure.camera.parameters + SIGMA * (root @ rng.normal(size=8))
        s = exposure.camera.with_parameters(x).directions(exposure.m, exposure.n)
        total += (residuals(exposure, s) ** 2).sum(axis=1)
    np.testing.assert_allclose(total / trials / found, 1.0, atol=0.12)
