"""Cameras whose every centroid has parameters of its own, against one camera a centroid."""

import numpy as np
import pytest

STARS = 40
SIGMA = np.array([8e-6, 30.0, 30.0, 1e8, 1e3, 0.01, 0.01, 2e-4])


@pytest.fixture
def scene(st16_camera):
    """(drifting camera (P, S), one camera a star, m, n)."""
    rng = np.random.default_rng(4)
    drift = 2.0 * SIGMA[:, None] * rng.normal(size=(8, STARS))
    drifting = st16_camera.with_parameters(st16_camera.parameters[:, None] + drift)
    single = [st16_camera.with_parameters(x) for x in drifting.parameters.T]
    m, n = rng.uniform(0, 1943, STARS), rng.uniform(0, 2591, STARS)
    return drifting, single, m, n


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
