"""Parts of the study ``wu``: images, criteria, singular values, bounds, comparisons."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from conftest import ROOT

from stcal.config import load_config
from stcal.constants import ARCSEC
from stcal.residuals import Residual
from stcal.studies import wu_comparison as compare
from stcal.studies.wu_convergence import images_outward, shown_images
from stcal.studies.wu_criteria import distribution_arcsec, pairs_of, quadratic_forms
from stcal.studies.wu_information import (
    constant_r_estimate,
    efficient_estimate,
    full_information,
    in_own_units,
    residual_covariance,
)
from stcal.studies.wu_runs import methods_of
from stcal.studies.wu_scene import LIMITS, MeasuredImages, Scene, make_scene, take_images
from stcal.studies.wu_values import derivatives, groups_of, least_observable, singular_values


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene(load_config(ROOT / "configs" / "wu2019.toml"), 300, 60)


@pytest.fixture(scope="module")
def images(scene: Scene) -> MeasuredImages:
    taken = take_images(scene, np.random.default_rng(5))
    return taken.brighter(scene.brightest(LIMITS[2]))


def angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def test_methods_are_residuals() -> None:
    tested = methods_of(2)
    assert tested["ad"] == Residual()
    assert tested["svd"] == Residual("singular-values", 4, (2, 3))
    assert tested["model 2"] == Residual("singular-values", 2, (2, 3))
    assert tested["values 1,3"] == Residual("singular-values", 4, (1, 3))
    assert len(tested) == 11
    assert list(methods_of(1)) == list(methods_of(3)) == ["ad", "svd"]


def test_images_show_the_catalogue_at_one_attitude(scene: Scene, images: MeasuredImages) -> None:
    known = images.known
    s_d = scene.true.directions(known.row_px, known.col_px)
    pairs = pairs_of(known)
    assert pairs.rmse_arcsec(s_d)[pairs.counts > 0].max() < 1e-6
    noise = np.concatenate([images.row_px - known.row_px, images.col_px - known.col_px])
    assert noise.std() == pytest.approx(0.5, rel=0.03)
    assert (np.diff(known.image) >= 0).all()
    # The brightest come first: that makes the groups of stars.
    within = np.diff(known.image) == 0
    assert (np.diff(known.star)[within] > 0).all()


def test_groups_of_images_share_their_stars(scene: Scene, images: MeasuredImages) -> None:
    fewer = images.brighter(scene.brightest(LIMITS[3]))
    kept = scene.matcher.catalogue.magnitude[images.known.star] <= LIMITS[3]
    assert np.array_equal(images.row_px[kept], fewer.row_px)
    assert fewer.known.n_images == images.known.n_images
    part = images.at(np.array([3, 7]))
    assert part.known.n_images == 2
    first, last = images.known.offsets[[7, 8]]
    assert np.array_equal(part.col_px[part.known.image == 1], images.col_px[first:last])


def test_criterion_of_all_pairs(scene: Scene, images: MeasuredImages) -> None:
    s_d = scene.true.directions(images.row_px, images.col_px)
    found = pairs_of(images.known).rmse_arcsec(s_d)
    first, last = images.known.offsets[[4, 5]]
    errors = [
        angle(s_d[a], s_d[b]) - angle(images.known.s_i[a], images.known.s_i[b])
        for a, b in itertools.combinations(range(first, last), 2)
    ]
    assert found[4] == pytest.approx(np.sqrt(np.mean(np.square(errors))) / ARCSEC)


def test_a_form_is_the_criterion_of_a_small_error(scene: Scene, images: MeasuredImages) -> None:
    known, true = images.known, scene.true
    pairs = pairs_of(known)
    step = 1e-4 * scene.scale * np.array([1.0, -2.0, 0.5, 0.3, 1.0, -1.0])
    moved = true.with_parameters(true.parameters + step)
    found = pairs.rmse_arcsec(moved.directions(known.row_px, known.col_px))
    forms = quadratic_forms(pairs, known, true)
    expected = np.sqrt(np.einsum("p,fpq,q->f", step, forms, step)) / ARCSEC
    some = pairs.counts > 0
    assert found[some] == pytest.approx(expected[some], rel=0.02)


def test_draws_have_the_mean_square_of_the_covariance() -> None:
    forms = np.diag([2.0, 3.0])[None]
    draws = distribution_arcsec(np.array([[4.0, 1.0], [1.0, 1.0]]), forms) * ARCSEC
    assert np.mean(draws**2) == pytest.approx(2.0 * 4.0 + 3.0 * 1.0, rel=0.1)


# Sizes of the star groups of an image with seven stars, and where they begin.
GROUPS = {
    1: ([3, 3, 3, 3, 3], [0, 1, 2, 3, 4]),
    2: ([3, 3, 3, 3, 3], [0, 1, 2, 3, 4]),
    3: ([6, 6], [0, 1]),
    4: ([3, 4, 5, 6, 7], [0, 0, 0, 0, 0]),
}


@pytest.mark.parametrize("model", GROUPS)
def test_star_groups_of_the_models(model: int) -> None:
    # Images with two, seven and eight stars.
    image, first, size = groups_of(np.array([0, 2, 9, 17]), model)
    sizes, starts = GROUPS[model]
    assert size[image == 1].tolist() == sizes
    assert (first[image == 1] - 2).tolist() == starts
    assert not (image == 0).any()
    if model == 2:
        assert size[image == 2].tolist() == [4] * 5


@pytest.mark.parametrize("model", GROUPS)
def test_singular_values_and_their_derivatives(
    model: int, scene: Scene, images: MeasuredImages
) -> None:
    known, true = images.between(0, 6).known, scene.true
    s_d, by_parameter, _ = true.jacobian(known.row_px, known.col_px)
    _, first, size = groups_of(known.offsets, model)
    found, _ = singular_values(s_d, first, size)
    place = len(first) // 2
    group = s_d[first[place] : first[place] + size[place]]
    assert found[place] == pytest.approx(np.linalg.svd(group, compute_uv=False), abs=1e-7)
    # The attitude doesn't matter.
    assert singular_values(known.s_i, first, size)[0] == pytest.approx(found, abs=1e-7)
    slopes = derivatives(s_d, by_parameter, first, size)
    for k, step in enumerate(1e-3 * scene.scale):
        shift = np.eye(6)[k] * step
        up, down = (
            singular_values(
                true.with_parameters(true.parameters + sign * shift).directions(
                    known.row_px, known.col_px
                ),
                first,
                size,
            )[0]
            for sign in (1.0, -1.0)
        )
        numeric = (up - down) / 2.0
        assert numeric == pytest.approx(slopes[:, :, k] * step, abs=1e-3 * np.abs(numeric).max())


def test_least_observable_is_zero_without_rank() -> None:
    rng = np.random.default_rng(2)
    full, flat = rng.normal(size=(5, 3)), rng.normal(size=(4, 2)) @ rng.normal(size=(2, 3))
    rows = np.concatenate([full, flat, rng.normal(size=(2, 3))])
    found = least_observable(rows, np.repeat([0, 1, 3], [5, 4, 2]), 4)
    assert found[0] == pytest.approx(np.linalg.svd(full, compute_uv=False)[-1])
    assert found[1:].tolist() == [0.0, 0.0, 0.0]


def test_images_outward_keep_their_stars(scene: Scene, images: MeasuredImages) -> None:
    known = images.known
    found = images_outward(scene, known)
    assert np.array_equal(found.image, known.image)
    distance = np.hypot(found.col_px - 970.0, found.row_px - 550.0)
    assert (np.diff(distance)[np.diff(found.image) == 0] >= 0.0).all()
    first, last = known.offsets[[2, 3]]
    assert sorted(found.star[first:last]) == sorted(known.star[first:last])


def test_no_residual_tells_more_than_the_centroids(scene: Scene, images: MeasuredImages) -> None:
    known = images.known
    total = full_information(scene, known).sum(axis=0)
    bound = np.diag(in_own_units(np.linalg.inv(total), scene.scale))
    ratios = {
        values: np.diag(residual_covariance(scene, known, residual)) / bound
        for values, residual in {
            "ad": Residual(),
            "svd": Residual("singular-values", 4, (2, 3)),
            "model 3": Residual("singular-values", 3, (2, 3)),
        }.items()
    }
    assert ratios["ad"] == pytest.approx(1.0, abs=0.05)
    assert ((ratios["svd"] > 0.98) & (ratios["svd"] < 1.25)).all()
    assert (ratios["model 3"] > 1.5).all()


RESIDUALS = (Residual(), Residual("singular-values", 4, (2, 3)))


def test_estimates_in_one_step_find_the_camera(scene: Scene, images: MeasuredImages) -> None:
    known, step = images.known, 1e-4 * scene.scale * np.array([1.0, -2.0, 0.5, 0.3, 1.0, -1.0])
    moved = scene.true.with_parameters(scene.true.parameters + step)
    row_px, col_px = moved.project(scene.true.directions(known.row_px, known.col_px))
    seen = MeasuredImages(known, row_px, col_px)
    estimates = [efficient_estimate(scene, seen)]
    estimates += [constant_r_estimate(scene, seen, residual) for residual in RESIDUALS]
    for found in estimates:
        assert (found - scene.true.parameters) / step == pytest.approx(np.ones(6), rel=0.05)


def test_estimates_in_one_step_err_as_they_should(scene: Scene) -> None:
    errors, constant = [], []
    for seed in range(12):
        images = take_images(scene, np.random.default_rng((7, seed))).between(0, 120)
        information = full_information(scene, images.known).sum(axis=0)
        error = (efficient_estimate(scene, images) - scene.true.parameters) / scene.scale
        errors.append(error @ information @ error / 6.0)
        for residual in RESIDUALS:
            other = constant_r_estimate(scene, images, residual) - scene.true.parameters
            constant.append((other / scene.scale) @ information @ (other / scene.scale) / 6.0)
    assert 0.7 < np.mean(errors) < 1.4
    # One variance for all values loses, the singular values most.
    assert np.mean(errors) < np.mean(constant[::2]) < np.mean(constant[1::2])


def test_shown_images_are_the_first_and_some_later_ones() -> None:
    found = shown_images(2400)
    assert found[:20].tolist() == list(range(1, 21))
    assert found[-1] == 2400
    assert len(found) < 130
    assert shown_images(5).tolist() == [1, 2, 3, 4, 5]


def test_differences_of_paired_runs() -> None:
    rng = np.random.default_rng(3)
    luck, own = rng.normal(size=40), 0.01 * rng.normal(size=40)
    found, sd = compare.difference(luck + own + 0.1, luck)
    assert found == pytest.approx(0.1, abs=0.01)
    # The luck that both share is no error.
    assert sd == pytest.approx(0.01 / np.sqrt(40), rel=0.4)
    assert compare.is_above(luck + own + 0.1, luck)
    assert not compare.is_above(luck, luck + own + 0.1)
    assert not compare.is_above(np.array([2.0, 2.0]), np.array([1.0, 1.0]))
    assert compare.is_above(2.0 * luck, luck, np.std)


def test_share_of_runs_below_a_value() -> None:
    distribution = {"percentiles": list(np.linspace(1.0, 3.0, 101))}
    assert compare.share_below(distribution, 1.5) == pytest.approx(0.25)
    assert compare.share_below(distribution, 9.0) == 1.0
    assert compare.share_below(distribution, 0.0) == 0.0
