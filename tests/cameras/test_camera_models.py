"""What every camera model must do, whatever its equations."""

import numpy as np
import pytest
from camera_cases import CASES
from hypothesis import given
from hypothesis import strategies as st

from stcal.cameras import CAMERAS

NAMES = pytest.mark.parametrize("name", CASES)
MOST = max(len(case.nominal) for case in CASES.values())

departures = st.lists(st.floats(-6.0, 6.0, allow_subnormal=False), min_size=MOST, max_size=MOST)
share = st.floats(0.0, 1.0)


def place(case, z, row_share, col_share):
    """The camera at the first values of z, and one centroid."""
    m, n = np.array([row_share * (case.rows - 1)]), np.array([col_share * (case.cols - 1)])
    return case.camera(z[: len(case.nominal)]), m, n


def test_every_model_has_a_case():
    assert CASES.keys() == CAMERAS.keys()
    for name, case in CASES.items():
        assert len(case.sigma) == len(case.effects) == len(CAMERAS[name].parameter_names)


@NAMES
@given(z=departures, row_share=share, col_share=share)
def test_jacobian_agrees_with_finite_differences(name, z, row_share, col_share):
    case = CASES[name]
    camera, m, n = place(case, z, row_share, col_share)
    x = camera.parameters
    s, by_parameter, by_pixel = camera.jacobian(m, n)
    np.testing.assert_allclose(s, camera.directions(m, n), atol=1e-15)
    for k, sigma in enumerate(case.sigma):
        step = np.zeros(len(x))
        step[k] = 1e-2 * sigma
        ahead, behind = (camera.with_parameters(x + sign * step) for sign in (1, -1))
        difference = ahead.directions(m, n) - behind.directions(m, n)
        np.testing.assert_allclose(
            by_parameter[:, :, k] * sigma, difference / 2e-2, rtol=1e-5, atol=1e-10
        )
    for k, (dm, dn) in enumerate(((0.1, 0.0), (0.0, 0.1))):
        difference = camera.directions(m + dm, n + dn) - camera.directions(m - dm, n - dn)
        np.testing.assert_allclose(by_pixel[:, :, k], difference / 0.2, rtol=1e-6, atol=1e-11)


@NAMES
@given(z=departures, row_share=share, col_share=share)
def test_projection_inverts_exactly(name, z, row_share, col_share):
    camera, m, n = place(CASES[name], z, row_share, col_share)
    back = camera.project(camera.directions(m, n))
    np.testing.assert_allclose(np.array(back), [m, n], rtol=0, atol=1e-10)


@NAMES
def test_undistorted_is_a_plain_pinhole(name):
    case = CASES[name]
    x = CAMERAS[name].undistorted(0.02, 300.0, 400.0)
    m, n = case.centroids(100)
    s = case.camera().with_parameters(x).directions(m, n)
    np.testing.assert_allclose(s[:, 0] / s[:, 2], case.pixel_size_m * (m - 300.0) / 0.02, 1e-14)
    np.testing.assert_allclose(s[:, 1] / s[:, 2], case.pixel_size_m * (n - 400.0) / 0.02, 1e-14)


@NAMES
def test_axes_follow_rows_and_columns(name):
    """In D, x runs along increasing row m and y along increasing column n."""
    case = CASES[name]
    camera = case.camera(np.zeros(len(case.nominal)))
    (m0,), (n0,) = camera.project(np.array([[0.0, 0.0, 1.0]]))
    s = camera.directions(m0 + np.array([28.0, 0.0]), n0 + np.array([0.0, 104.0]))
    assert s[0, 0] > 0
    assert s[0, 1] == 0
    assert s[1, 1] > 0
    assert s[1, 0] == 0


@NAMES
def test_directions_without_an_image_are_nan(name):
    m, n = (
        CASES[name]
        .camera()
        .project(np.array([[0.0, 0.0, -1.0], [0.6, 0.0, -0.8], [0.0, 0.0, 1.0]]))
    )
    assert np.isnan(m[:2]).all()
    assert np.isnan(n[:2]).all()
    assert np.isfinite([m[2], n[2]]).all()


@NAMES
def test_noise_scale_is_the_direction_spread_of_pixel_noise(name):
    case = CASES[name]
    camera = case.camera()
    rng = np.random.default_rng(1)
    m, n = np.full((2, 200_000), [[0.15 * case.rows], [0.9 * case.cols]])
    sd = 0.3
    noisy = camera.directions(m + rng.normal(0, sd, m.shape), n + rng.normal(0, sd, n.shape))
    mean = camera.directions(m[:1], n[:1])
    spread = np.sqrt(((noisy - mean) ** 2).sum(axis=1).mean() / 2)
    assert spread == pytest.approx(sd * camera.noise_scale(m[:1], n[:1])[0], rel=0.01)


@NAMES
def test_noise_scale_slopes_are_its_derivatives(name):
    case = CASES[name]
    camera = case.camera()
    m, n = case.centroids(300, seed=2)
    slopes = camera.noise_scale_slopes(m, n)
    x = camera.parameters
    for k, sigma in enumerate(case.sigma):
        step = np.zeros(len(x))
        step[k] = 0.05 * sigma
        up, down = (camera.with_parameters(x + d).noise_scale(m, n) for d in (step, -step))
        numeric = np.log(up / down) / 0.1
        np.testing.assert_allclose(slopes[:, k] * sigma, numeric, atol=5e-3 * np.abs(numeric).max())
