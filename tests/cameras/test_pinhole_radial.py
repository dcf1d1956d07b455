import numpy as np
import pytest
from camera_cases import CASES
from hypothesis import given
from hypothesis import strategies as st

from stcal.cameras.pinhole_radial import pixel_guess, shrink

CASE = CASES["pinhole-radial"]

departures = st.lists(st.floats(-6.0, 6.0, allow_subnormal=False), min_size=6, max_size=6)
rows = st.floats(0.0, 1079.0)
cols = st.floats(0.0, 1919.0)


def printed_equations(x, w):
    """Wu 2019 eqs (1)-(7), one star, written down literally: w = [X, Y, Z] to (u_d, v_d).

    (6) is printed with u and v, but means their distances from the principal point.
    """
    s, f, u0, v0, k1, k2 = x
    D_u = 2.9e-6
    D_v = s * D_u
    f_u, f_v = f / D_u, f / D_v
    X, Y, Z = w
    u, v, _ = np.array([[f_u, 0, u0], [0, f_v, v0], [0, 0, 1]]) @ [X / Z, Y / Z, 1.0]
    r = np.sqrt((u - u0) ** 2 / f_u**2 + (v - v0) ** 2 / f_v**2)
    delta_u = (u - u0) * (k1 * r**2 + k2 * r**4)
    delta_v = (v - v0) * (k1 * r**2 + k2 * r**4)
    return u + delta_u, v + delta_v


@given(departures, rows, cols)
def test_direction_inverts_the_printed_equations(z, m, n):
    camera = CASE.camera(z)
    s = camera.directions(np.array([m]), np.array([n]))[0]
    # Wu's X runs along the columns, which is y of D, and Y along the rows.
    u_d, v_d = printed_equations(camera.parameters, (s[1], s[0], s[2]))
    np.testing.assert_allclose((v_d, u_d), (m, n), rtol=0, atol=1e-9)


def test_projection_is_the_printed_equations():
    camera = CASE.camera()
    s = camera.directions(*CASE.centroids(200))
    m, n = camera.project(s)
    u_d, v_d = np.array([printed_equations(camera.parameters, (y, x, z)) for x, y, z in s]).T
    np.testing.assert_allclose((m, n), (v_d, u_d), rtol=0, atol=1e-9)
    # The forward map is closed, so the start of the inverse is its end.
    start = pixel_guess(camera.parameters, camera.pixel_size_m, s)
    np.testing.assert_allclose(start, (v_d, u_d), rtol=0, atol=1e-9)


@pytest.mark.parametrize("distortion", [-0.3, -0.1, 0.1, 0.5])
def test_the_undistorted_radius_solves_its_equation(distortion):
    """Distortions of the radius up to these, in the quadratic, the quartic, and both terms."""
    r = np.linspace(0.01, 1.0, 50)
    for k1, k2 in ((distortion, 0.0), (0.0, distortion), (distortion, -0.5 * distortion)):
        r_d = r * (1.0 + k1 * r**2 + k2 * r**4)
        one_to_one = 1.0 + 3.0 * k1 * r**2 + 5.0 * k2 * r**4 > 0.1
        found = r_d * shrink(r_d * r_d, k1, k2)
        np.testing.assert_allclose(found[one_to_one], r[one_to_one], rtol=1e-12)


def test_aspect_is_the_height_of_a_pixel_over_its_width():
    square = CASE.camera(np.zeros(6))
    tall = square.with_parameters(square.parameters * [1.25, 1, 1, 1, 0, 0])
    (s,) = tall.directions(np.array([550.0 + 80.0]), np.array([970.0 + 80.0]))
    assert s[0] / s[1] == pytest.approx(1.25, rel=1e-14)
