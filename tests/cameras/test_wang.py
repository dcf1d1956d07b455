import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stcal.cameras import CAMERAS, Camera
from stcal.cameras.wang import ray

SIGMA = np.array([8e-6, 30.0, 30.0, 1e8, 1e3, 0.01, 0.01, 2e-4])
NOMINAL = np.array([0.016, 972.0, 1296.0, 0.0, 0.0, 0.0, 0.0, 1.0])

parameters = st.lists(st.floats(-6.0, 6.0, allow_subnormal=False), min_size=8, max_size=8).map(
    lambda z: NOMINAL + SIGMA * np.array(z)
)
rows = st.floats(0.0, 1943.0)
cols = st.floats(0.0, 2591.0)


def camera(x) -> Camera:
    return Camera(CAMERAS["wang"], 1944, 2592, 2.2e-6, np.asarray(x))


def printed_equations(x, m, n):
    """Enright 2018 eqs (1)-(7), one star, written down literally."""
    f, m0, n0, b4, b2, a1, a2, g_y = x
    u, v = 2.2e-6 * (m - m0), g_y * 2.2e-6 * (n - n0)
    U, V = u * f / (a1 * v + a2 * u + f), v * f / (a1 * v + a2 * u + f)
    rho = np.hypot(U, V)
    B = 1 + b2 * rho**2 + b4 * rho**4
    r = np.array([B * U, B * V, f])
    return r / np.linalg.norm(r)


@given(parameters, rows, cols)
def test_direction_is_the_printed_equations(x, m, n):
    s = camera(x).directions(np.array([m]), np.array([n]))[0]
    np.testing.assert_allclose(s, printed_equations(x, m, n), rtol=0, atol=1e-15)


@given(parameters, rows, cols)
def test_jacobian_agrees_with_finite_differences(x, m, n):
    m, n = np.array([m]), np.array([n])
    s, by_parameter, by_pixel = camera(x).jacobian(m, n)
    np.testing.assert_allclose(s, camera(x).directions(m, n), atol=1e-15)
    for k, sigma in enumerate(SIGMA):
        step = np.zeros(8)
        step[k] = 1e-2 * sigma
        difference = camera(x + step).directions(m, n) - camera(x - step).directions(m, n)
        np.testing.assert_allclose(
            by_parameter[:, :, k] * sigma, difference / 2e-2, rtol=1e-5, atol=1e-10
        )
    for k, (dm, dn) in enumerate(((0.1, 0.0), (0.0, 0.1))):
        difference = camera(x).directions(m + dm, n + dn) - camera(x).directions(m - dm, n - dn)
        np.testing.assert_allclose(by_pixel[:, :, k], difference / 0.2, rtol=1e-6, atol=1e-11)


@given(parameters, rows, cols)
def test_projection_inverts_exactly(x, m, n):
    m, n = np.array([m]), np.array([n])
    back = camera(x).project(camera(x).directions(m, n))
    np.testing.assert_allclose(np.array(back), [m, n], rtol=0, atol=1e-10)


def test_projection_agrees_with_the_closed_form(st16_camera):
    """U, V by solving B(rho) with a polynomial root finder, then D (theory of the inverse)."""
    f, m0, n0, b4, b2, a1, a2, g_y = st16_camera.parameters
    s = st16_camera.directions(np.array([100.0, 1800.0]), np.array([2500.0, 30.0]))
    for k, (m, n) in enumerate(zip(*st16_camera.project(s), strict=True)):
        x, y = f * s[k, 0] / s[k, 2], f * s[k, 1] / s[k, 2]
        roots = np.roots([b4, 0, b2, 0, 1, -np.hypot(x, y)])
        real = roots[np.abs(roots.imag) < 1e-12].real
        rho = real[np.argmin(np.abs(real - np.hypot(x, y)))]
        U, V = x * rho / np.hypot(x, y), y * rho / np.hypot(x, y)
        D = f / (1 - (a1 * V + a2 * U) / f)
        assert m == pytest.approx(m0 + U * D / f / 2.2e-6, abs=1e-9)
        assert n == pytest.approx(n0 + V * D / f / (2.2e-6 * g_y), abs=1e-9)


def test_directions_without_an_image_are_nan(st16_camera):
    m, n = st16_camera.project(np.array([[0.0, 0.0, -1.0], [0.6, 0.0, -0.8], [0.0, 0.0, 1.0]]))
    assert np.isnan(m[:2]).all()
    assert np.isnan(n[:2]).all()
    assert np.isfinite([m[2], n[2]]).all()


def test_noise_scale_is_the_direction_spread_of_pixel_noise(st16_camera):
    rng = np.random.default_rng(1)
    m, n = np.full(200_000, 300.0), np.full(200_000, 2300.0)
    sd = 0.3
    noisy = st16_camera.directions(m + rng.normal(0, sd, m.shape), n + rng.normal(0, sd, n.shape))
    mean = st16_camera.directions(m[:1], n[:1])
    spread = np.sqrt(((noisy - mean) ** 2).sum(axis=1).mean() / 2)
    assert spread == pytest.approx(sd * st16_camera.noise_scale(m[:1], n[:1])[0], rel=0.01)


def test_axes_follow_rows_and_columns():
    s = camera(NOMINAL).directions(np.array([1000.0, 972.0]), np.array([1296.0, 1400.0]))
    assert s[0, 0] > 0
    assert s[0, 1] == 0
    assert s[1, 1] > 0
    assert s[1, 0] == 0
    assert ray(NOMINAL, 2.2e-6, np.array([5.0]), np.array([5.0]))[2] == 0.016


def test_noise_scale_slopes_are_its_derivatives(st16_camera):
    rng = np.random.default_rng(2)
    m, n = rng.uniform(0, 1943, 300), rng.uniform(0, 2591, 300)
    slopes = st16_camera.noise_scale_slopes(m, n)
    x = st16_camera.parameters
    for k, sigma in enumerate(SIGMA):
        step = np.zeros(8)
        step[k] = 0.05 * sigma
        up, down = (camera(x + sign * step).noise_scale(m, n) for sign in (1, -1))
        numeric = np.log(up / down) / 0.1
        np.testing.assert_allclose(slopes[:, k] * sigma, numeric, atol=5e-3 * np.abs(numeric).max())
