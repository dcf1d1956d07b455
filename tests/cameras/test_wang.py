import numpy as np
import pytest
from camera_cases import CASES
from hypothesis import given
from hypothesis import strategies as st

from stcal.cameras.wang import ray

CASE = CASES["wang"]

departures = st.lists(st.floats(-6.0, 6.0, allow_subnormal=False), min_size=8, max_size=8)
rows = st.floats(0.0, 1943.0)
cols = st.floats(0.0, 2591.0)


def printed_equations(x, m, n):
    """Enright 2018 eqs (1)-(7), one star, written down literally."""
    f, m0, n0, b4, b2, a1, a2, g_y = x
    u, v = 2.2e-6 * (m - m0), g_y * 2.2e-6 * (n - n0)
    U, V = u * f / (a1 * v + a2 * u + f), v * f / (a1 * v + a2 * u + f)
    rho = np.hypot(U, V)
    B = 1 + b2 * rho**2 + b4 * rho**4
    r = np.array([B * U, B * V, f])
    return r / np.linalg.norm(r)


@given(departures, rows, cols)
def test_direction_is_the_printed_equations(z, m, n):
    camera = CASE.camera(z)
    s = camera.directions(np.array([m]), np.array([n]))[0]
    np.testing.assert_allclose(s, printed_equations(camera.parameters, m, n), rtol=0, atol=1e-15)


def test_projection_agrees_with_the_closed_form():
    """U, V by solving B(rho) with a polynomial root finder, then D (theory of the inverse)."""
    camera = CASE.camera()
    f, m0, n0, b4, b2, a1, a2, g_y = camera.parameters
    s = camera.directions(np.array([100.0, 1800.0]), np.array([2500.0, 30.0]))
    for k, (m, n) in enumerate(zip(*camera.project(s), strict=True)):
        x, y = f * s[k, 0] / s[k, 2], f * s[k, 1] / s[k, 2]
        roots = np.roots([b4, 0, b2, 0, 1, -np.hypot(x, y)])
        real = roots[np.abs(roots.imag) < 1e-12].real
        rho = real[np.argmin(np.abs(real - np.hypot(x, y)))]
        U, V = x * rho / np.hypot(x, y), y * rho / np.hypot(x, y)
        D = f / (1 - (a1 * V + a2 * U) / f)
        assert m == pytest.approx(m0 + U * D / f / 2.2e-6, abs=1e-9)
        assert n == pytest.approx(n0 + V * D / f / (2.2e-6 * g_y), abs=1e-9)


def test_rays_are_in_metres():
    assert ray(np.array(CASE.nominal), 2.2e-6, np.array([5.0]), np.array([5.0]))[2] == 0.016
