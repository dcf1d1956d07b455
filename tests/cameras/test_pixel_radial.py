import numpy as np
from camera_cases import CASES
from hypothesis import given
from hypothesis import strategies as st

CASE = CASES["pixel-radial"]

departures = st.lists(st.floats(-6.0, 6.0, allow_subnormal=False), min_size=5, max_size=5)
pixels = st.floats(0.0, 1023.0)


def printed_equations(parameters, x, y):
    """Zhang 2024 eqs (13)-(15) without noise and (17), one star, written down literally."""
    x0, y0, f, k1, k2 = parameters
    r = np.sqrt((x - x0) ** 2 + (y - y0) ** 2)
    x_hat = x + (x - x0) * (k1 * r**2 + k2 * r**4)
    y_hat = y + (y - y0) * (k1 * r**2 + k2 * r**4)
    f_px = f / 18e-6
    w = np.array([x_hat - x0, y_hat - y0, f_px])
    return w / np.sqrt((x_hat - x0) ** 2 + (y_hat - y0) ** 2 + f_px**2)


@given(departures, pixels, pixels)
def test_direction_is_the_printed_equations(z, m, n):
    camera = CASE.camera(z)
    s = camera.directions(np.array([m]), np.array([n]))[0]
    # Zhang's image axes are those of D: x along the rows, y along the columns.
    np.testing.assert_allclose(s, printed_equations(camera.parameters, m, n), rtol=0, atol=1e-15)


def test_positive_distortion_moves_directions_outwards():
    """The definition goes from the distorted to the ideal place, not the other way."""
    camera = CASE.camera([0.0, 0.0, 0.0, 0.0, 1.0])  # k2 = 0
    (s,) = camera.directions(np.array([511.5 + 400.0]), np.array([511.5]))
    ideal_px = 400.0 * (1.0 + 2e-8 * 400.0**2)
    np.testing.assert_allclose(s[0] / s[2], ideal_px * 18e-6 / 0.074, rtol=1e-14)
