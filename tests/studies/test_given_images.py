"""Images of known stars, and the Cramer-Rao bound that they set."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from conftest import ROOT
from scipy.spatial.transform import Rotation

from stcal.simulate import load_scenario
from stcal.studies.bound import bound_over_images, image_information, pixel_jacobians
from stcal.studies.given import KnownImages, matched_images
from stcal.studies.zhang_scene import Scene, make_scene

EPOCH = 10**18


@cache
def scene() -> Scene:
    return make_scene(load_scenario(ROOT / "configs" / "scenarios" / "zhang2024.toml"), 20.0, 10.0)


def test_every_star_lies_where_the_camera_sees_it() -> None:
    images = scene().images
    c_di = scene().c_sb @ scene().c_bi
    s_d = np.einsum("kij,kj->ki", c_di[images.image], images.s_i)
    seen = scene().true.directions(images.row_px, images.col_px)
    np.testing.assert_allclose(seen, s_d, atol=1e-12)
    assert scene().true.contains(images.row_px, images.col_px).all()
    assert (np.diff(images.image) >= 0).all()


def test_no_star_in_the_field_is_missing() -> None:
    images, catalogue = scene().images, scene().matcher.catalogue
    for f in (0, images.n_images - 1):
        s_d = catalogue.direction @ (scene().c_sb @ scene().c_bi[f]).T
        m, n = scene().true.project(s_d)
        near = (s_d[:, 2] > np.cos(np.deg2rad(12.0))) & scene().true.contains(m, n)
        assert set(np.flatnonzero(near)) == set(images.star[images.image == f])


def test_telemetry_has_one_image_a_frame() -> None:
    images, true = scene().images, scene().true
    found = matched_images(images, images.row_px, images.col_px, true, "ZHANG-1", EPOCH)
    count = np.bincount(images.image)
    np.testing.assert_array_equal(found.frames.stars_per_exposure[::2], count)
    assert not found.frames.stars_per_exposure[1::2].any()
    np.testing.assert_array_equal(found.solved, np.tile([True, False], images.n_images))
    np.testing.assert_allclose(found.c_di[::2], scene().c_sb @ scene().c_bi, atol=1e-12)
    assert found.residual.max() < 1e-12
    assert found.frames.t_tai_ns[3] == EPOCH + 3 * 10**9


def test_a_part_of_the_images() -> None:
    images = scene().images
    part = images.between(5, 9)
    taken = (images.image >= 5) & (images.image < 9)
    np.testing.assert_array_equal(part.star, images.star[taken])
    np.testing.assert_array_equal(part.row_px, images.row_px[taken])
    np.testing.assert_array_equal(part.image, images.image[taken] - 5)
    np.testing.assert_array_equal(part.t_s, [0.0, 1.0, 2.0, 3.0])


def test_pixel_jacobians_against_finite_differences() -> None:
    camera = scene().true
    row, col = np.array([20.0, 511.0, 900.0]), np.array([1000.0, 300.0, 600.0])
    s = camera.directions(row, col)
    by_parameter, by_attitude = pixel_jacobians(camera, row, col)
    for k, step in enumerate(1e-4 * scene().scale):
        change = np.zeros(5)
        change[k] = step
        ends = [
            camera.with_parameters(camera.parameters + sign * change).project(s) for sign in (1, -1)
        ]
        numeric = (np.stack(ends[0], 1) - np.stack(ends[1], 1)) / (2.0 * step)
        np.testing.assert_allclose(by_parameter[:, :, k], numeric, rtol=1e-5, atol=1e-6 / step)
    for axis in range(3):
        turn = 1e-6 * np.eye(3)[axis]
        ends = [camera.project(Rotation.from_rotvec(sign * turn).apply(s)) for sign in (1, -1)]
        numeric = (np.stack(ends[0], 1) - np.stack(ends[1], 1)) / 2e-6
        np.testing.assert_allclose(by_attitude[:, :, axis], numeric, rtol=1e-5, atol=1e-2)


def test_bound_is_that_of_the_joint_problem() -> None:
    """Parameters and the attitudes of all images in one Fisher matrix, inverted as a whole."""
    images, scale, sd = scene().images.between(0, 4), scene().scale, 0.2
    by_parameter, by_attitude = pixel_jacobians(scene().true, images.row_px, images.col_px)
    joint = np.zeros((2 * len(images.star), 5 + 3 * images.n_images))
    joint[:, :5] = (by_parameter * scale).reshape(-1, 5) / sd
    for k, f in enumerate(images.image):
        joint[2 * k : 2 * k + 2, 5 + 3 * f : 8 + 3 * f] = by_attitude[k] / sd
    expected = np.linalg.inv(joint.T @ joint)[:5, :5]
    information = image_information(images, scene().true, sd, scale)
    bound = bound_over_images(information)
    np.testing.assert_allclose(bound[-1], expected, rtol=1e-5)
    # What is known before adds to what the images tell.
    known = bound_over_images(information, np.eye(5))[-1]
    np.testing.assert_allclose(np.linalg.inv(known), np.linalg.inv(expected) + np.eye(5), rtol=1e-5)


def test_images_without_enough_stars_tell_nothing() -> None:
    row = col = np.array([100.0])
    lone = KnownImages(
        np.zeros(1), np.zeros(1, int), np.zeros(1, int), scene().true.directions(row, col), row, col
    )
    information = image_information(lone, scene().true, 0.2, scene().scale)
    np.testing.assert_allclose(information, 0.0, atol=1e-6)
    assert np.isnan(bound_over_images(information)).all()


@pytest.mark.parametrize("count", [1, 2])
def test_few_stars_leave_an_image_unsolved(count: int) -> None:
    images = scene().images.between(0, 2)
    kept = (images.image == 1) | (np.arange(len(images.star)) < count)
    few = KnownImages(
        images.t_s, images.image[kept], images.star[kept], images.s_i[kept],
        images.row_px[kept], images.col_px[kept],
    )  # fmt: skip
    found = matched_images(few, few.row_px, few.col_px, scene().true, "ZHANG-1", EPOCH)
    assert list(found.solved) == [False, False, True, False]
    assert np.isnan(found.c_di[0]).all()
    assert list(found.reason) == [1, 1, 0, 1]
