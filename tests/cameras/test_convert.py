import numpy as np
import pytest
from camera_cases import CASES

from stcal.cameras import CAMERAS
from stcal.cameras.convert import convert, detector_grid
from stcal.geometry.rotations import matrix_from_vector, vector_from_matrix

PAIRS = [(old, new) for old in CASES for new in CASES if old != new]
URAD = 1e-6


def rms(conversion) -> float:
    return float(np.sqrt(np.mean(conversion.angle**2)))


def test_the_grid_spans_the_detector_from_edge_to_edge():
    row, col = detector_grid(CASES["wang"].camera(), 9)
    assert (row.min(), row.max()) == (-0.5, 1943.5)
    assert (col.min(), col.max()) == (-0.5, 2591.5)
    assert (len(np.unique(row)), len(np.unique(col))) == (7, 9)


@pytest.mark.parametrize("name", CASES)
def test_a_cameras_own_model_gives_the_camera_itself(name):
    camera = CASES[name].camera()
    found = convert(camera, camera.model)
    assert np.array_equal(found.camera.parameters, camera.parameters)
    assert np.array_equal(found.turn, np.eye(3))
    assert np.array_equal(found.sensitivity, np.eye(len(camera.parameters)))
    assert (found.angle == 0.0).all()
    assert np.abs(found.error_px).max() < 1e-10
    assert found.converged


def test_zhang_and_wang_are_one_model_without_tilt_and_aspect():
    """x_hat = x (1 + k1 r^2 + k2 r^4) is B(rho) with b2 = k1 / p^2 and b4 = k2 / p^4."""
    zhang = CASES["pixel-radial"].camera()
    x0, y0, f, k1, k2 = zhang.parameters
    there = convert(zhang, CAMERAS["wang"])
    p = zhang.pixel_size_m
    expected = [f, x0, y0, k2 / p**4, k1 / p**2, 0.0, 0.0, 1.0]
    np.testing.assert_allclose(there.camera.parameters, expected, rtol=1e-8, atol=1e-12)
    assert there.angle.max() < 1e-13
    back = convert(there.camera, CAMERAS["pixel-radial"])
    np.testing.assert_allclose(back.camera.parameters, zhang.parameters, rtol=1e-8)
    assert back.angle.max() < 1e-13


@pytest.mark.parametrize(("old", "new"), PAIRS)
def test_the_result_says_how_the_new_camera_departs(old, new):
    """The turn takes new D to old D, and the errors hold off the grid too."""
    case = CASES[old]
    camera = case.camera()
    found = convert(camera, CAMERAS[new])
    m, n = case.centroids(300)
    turned = found.camera.directions(m, n) @ found.turn.T
    left = np.linalg.norm(turned - camera.directions(m, n), axis=1)
    assert left.max() <= 1.05 * found.angle.max() + 1e-12
    if rms(found) > 1e-12:
        assert 0.5 < np.sqrt(np.mean(left**2)) / rms(found) < 1.2
    # In pixels: where the new camera sees what the old one saw there.
    s_new = camera.directions(found.row_px, found.col_px) @ found.turn
    seen = np.stack(found.camera.project(s_new), axis=1)
    expected = seen - np.stack([found.row_px, found.col_px], axis=1)
    np.testing.assert_allclose(found.error_px, expected, atol=1e-9)


@pytest.mark.parametrize(("old", "new"), PAIRS)
def test_no_camera_beside_it_is_nearer(old, new):
    camera = CASES[old].camera()
    found = convert(camera, CAMERAS[new])
    row, col = found.row_px, found.col_px
    target = camera.directions(row, col)

    def distance(parameters, vector) -> float:
        s_d = found.camera.with_parameters(parameters).directions(row, col)
        turn = matrix_from_vector(vector[None])[0] @ found.turn
        return float(np.sqrt(np.mean((s_d @ turn.T - target) ** 2)))

    x, here = found.camera.parameters, np.zeros(3)
    best = distance(x, here)
    for sign in (-1.0, 1.0):
        for k, sigma in enumerate(CASES[new].sigma):
            step = np.zeros(len(x))
            step[k] = sign * 1e-2 * sigma
            assert distance(x + step, here) > best
        for axis in np.eye(3):
            assert distance(x, sign * URAD * axis) > best


def test_a_tilted_detector_becomes_a_turned_boresight():
    """To first order: wang's plane of points (u, v, f + a2 u + a1 v) is nearest at -f (a2, a1)."""
    tilted = CASES["wang"].camera([0.0, 0.0, 0.0, 0.0, 0.0, 0.5, -1.0, 0.0])
    found = convert(tilted, CAMERAS["pixel-radial"])
    f, a1, a2 = 0.016, 0.005, -0.01
    moved = np.array(found.camera.parameters[:2]) - (972.0, 1296.0)
    np.testing.assert_allclose(moved * 2.2e-6, [-f * a2, -f * a1], rtol=0.05)
    x, y, _ = vector_from_matrix(found.turn[None])[0]
    np.testing.assert_allclose((x, y), (a1, -a2), rtol=0.05)
    assert found.angle.max() < 60 * URAD
    # Without the turn it would be the whole angle.
    unturned = found.camera.directions(found.row_px, found.col_px)
    old = tilted.directions(found.row_px, found.col_px)
    assert np.linalg.norm(unturned - old, axis=1).min() > 0.005


@pytest.mark.parametrize(("old", "new"), PAIRS)
def test_sensitivity_is_how_the_solution_follows(old, new):
    """Near the nominal cameras, where little is left of the difference."""
    case = CASES[old]
    tiny = np.full(len(case.nominal), 0.3)
    if old == "wang":
        tiny[5:7] = 0.0  # the tilt has no counterpart
    camera = case.camera(tiny)
    found = convert(camera, CAMERAS[new])
    for k, sigma in enumerate(case.sigma):
        if old == "wang" and k >= 5:
            continue
        step = np.zeros(len(tiny))
        step[k] = 1e-2 * sigma
        ahead, behind = (
            convert(camera.with_parameters(camera.parameters + d), CAMERAS[new]).camera.parameters
            for d in (step, -step)
        )
        expected = (ahead - behind) / 2e-2 / CASES[new].sigma
        scaled = found.sensitivity[:, k] * sigma / CASES[new].sigma
        np.testing.assert_allclose(scaled, expected, rtol=0, atol=0.02 * np.abs(expected).max())
