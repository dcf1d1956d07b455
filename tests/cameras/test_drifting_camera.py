"""Cameras whose every centroid has parameters of its own, against one camera a centroid."""

import numpy as np
import pytest
from camera_cases import CASES

STARS = 40


@pytest.fixture(params=CASES)
def scene(request):
    """(drifting camera (P, S), one camera a star, m, n)."""
    case = CASES[request.param]
    camera = case.camera()
    departures = np.random.default_rng(4).normal(size=(len(case.nominal), STARS))
    drift = 2.0 * np.array(case.sigma)[:, None] * departures
    drifting = camera.with_parameters(camera.parameters[:, None] + drift)
    single = [camera.with_parameters(x) for x in drifting.parameters.T]
    return drifting, single, *case.centroids(STARS)


def test_maps_are_those_of_single_cameras(scene):
    drifting, single, m, n = scene
    s, by_parameter, by_pixel = drifting.jacobian(m, n)
    np.testing.assert_allclose(drifting.directions(m, n), s, rtol=0, atol=1e-15)
    scale = drifting.noise_scale(m, n)
    for k, camera in enumerate(single):
        one = camera.jacobian(m[k : k + 1], n[k : k + 1])
        for found, expected in zip((s, by_parameter, by_pixel), one, strict=True):
            np.testing.assert_allclose(found[k], expected[0], rtol=1e-14, atol=0)
        assert scale[k] == pytest.approx(camera.noise_scale(m[k : k + 1], n[k : k + 1])[0], 1e-14)


def test_projection_inverts_each_centroids_own_camera(scene):
    drifting, single, m, n = scene
    back = drifting.project(drifting.directions(m, n))
    np.testing.assert_allclose(np.array(back), [m, n], rtol=0, atol=1e-9)
    # Another camera's image lies elsewhere, so the test above isn't of one camera alone.
    other = single[0].project(drifting.directions(m, n))
    assert np.abs(np.array(other) - [m, n])[:, 1:].max() > 1.0
