"""The parts of the study ``zhang``: noise, filters against the bound, and the second stage."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from conftest import ROOT
from scipy.stats import chi2

from stcal.attitude import solve_wahba
from stcal.errors import ConfigError
from stcal.estimators.misalignment import Sightings
from stcal.geometry.rotations import vector_from_matrix
from stcal.simulate import load_scenario, scenario_with
from stcal.simulate.orbit import orbit_from, state
from stcal.studies.given import KnownImages
from stcal.studies.zhang_alignment import (
    NINE,
    TRUE,
    Mountings,
    align_all,
    nine_elements,
    stops_of,
    turn_by_camera,
)
from stcal.studies.zhang_calibration import bounds, image_at, sd_of, settled_s, shown_images
from stcal.studies.zhang_image import grid_over, image_form, published_corner, without_turn
from stcal.studies.zhang_noise import CentroidNoise, draw_errors, gauss_markov
from stcal.studies.zhang_paper import published, true_mounting
from stcal.studies.zhang_runs import FILTERS, OURS, PAPER, Draws, MonteCarlo, Tracks, calibrate
from stcal.studies.zhang_scene import Scene, make_scene

SCENARIO = ROOT / "configs" / "scenarios" / "zhang2024.toml"
RUNS = 24


@cache
def scene() -> Scene:
    return make_scene(load_scenario(SCENARIO), 79.0, 39.0)


@cache
def tracks() -> dict[str, Tracks]:
    return calibrate(
        scene(), scene().calibration, CentroidNoise(), tuple(FILTERS), MonteCarlo(RUNS, Draws(5))
    )


def within(value: float, degrees: int) -> bool:
    """Whether a chi-square over its degrees of freedom is where 99.9 % of them are."""
    low, high = chi2.ppf([0.0005, 0.9995], degrees) / degrees
    return bool(low <= value <= high)


def test_the_body_points_to_the_zenith_and_along_the_track() -> None:
    scenario = load_scenario(SCENARIO)
    orbit = orbit_from(scenario.orbit, scenario.epoch_tai_ns)
    t_s = 1e-9 * (scene().epoch - scenario.epoch_tai_ns) + scene().images.t_s
    position, velocity = (v / np.linalg.norm(v, axis=1)[:, None] for v in state(orbit, t_s))
    up, along = (np.einsum("fij,fj->fi", scene().c_bi, v) for v in (position, velocity))
    np.testing.assert_allclose(up, np.tile([0.0, 0.0, 1.0], (len(t_s), 1)), atol=1e-9)
    np.testing.assert_allclose(along[:, 0], 1.0, atol=1e-3)


def test_white_noise_has_its_sd_and_begins_alike() -> None:
    images = scene().images
    long = draw_errors(CentroidNoise(0.3), images, scene().true, np.random.default_rng(3))
    assert long.std() == pytest.approx(0.3, rel=0.05)
    short = draw_errors(
        CentroidNoise(0.1), images.between(0, 7), scene().true, np.random.default_rng(3)
    )
    np.testing.assert_allclose(3.0 * short, long[:, : short.shape[1]], rtol=1e-12)


def test_low_frequency_processes_are_stationary_with_their_time_constant() -> None:
    noise, t_s = CentroidNoise(time_constant_s=20.0), np.arange(4000.0)
    found = gauss_markov(t_s, noise, (2, 30), np.random.default_rng(1))
    assert found.shape == (4000, 2, 30)
    assert found[0].std() == pytest.approx(1.0, abs=0.2)
    assert found.std() == pytest.approx(1.0, abs=0.05)
    for lag in (5, 20):
        kept = (found[lag:] * found[:-lag]).mean()
        assert kept == pytest.approx(np.exp(-lag / 20.0), abs=0.05)


def test_a_displacement_is_common_and_a_distortion_is_quadratic() -> None:
    images = scene().images
    rng = np.random.default_rng
    common = draw_errors(CentroidNoise(0.0, common=0.5), images, scene().true, rng(1))
    for f in range(3):
        assert np.ptp(common[:, images.image == f], axis=1).max() < 1e-12
    grid = grid_over(scene().true)
    field = np.concatenate(
        [
            draw_errors(CentroidNoise(0.0, field=0.5), twice(grid), scene().true, rng(k))
            for k in range(300)
        ]
    )
    # The edges of the grid weigh more than the detector's.
    assert np.sqrt((field**2).mean()) == pytest.approx(0.5, rel=0.2)
    u = grid.row_px / 512.0 - 1.0
    terms = np.stack([np.ones(len(u)), u, v := grid.col_px / 512.0 - 1.0, u * u, v * v, u * v])
    left = field[:, : len(u)] - (field[:, : len(u)] @ np.linalg.pinv(terms)) @ terms
    assert np.abs(left).max() < 1e-9


def twice(grid: KnownImages) -> KnownImages:
    """Two images with the same stars: a process needs a time step."""
    columns = {
        name: np.concatenate([getattr(grid, name)] * 2)
        for name in ("star", "s_i", "row_px", "col_px")
    }
    return replace(grid, t_s=np.arange(2.0), image=np.repeat([0, 1], len(grid.star)), **columns)


def test_filters_know_their_errors() -> None:
    for name in (OURS, "ukf_arclength", "sqrf_direction"):
        track = tracks()[name]
        error = track.error[:, -1] / scene().scale
        covariance = track.covariance / np.outer(scene().scale, scene().scale)
        nees = np.einsum("rp,rp->r", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0])
        assert within(nees.sum() / (5 * RUNS), 5 * RUNS), name
        np.testing.assert_allclose(track.sd[:, -1] ** 2, covariance_diagonal(track), rtol=1e-6)


def covariance_diagonal(track: Tracks) -> np.ndarray:
    return np.diagonal(track.covariance, axis1=1, axis2=2)


def test_filters_reach_the_bound() -> None:
    least = sd_of(bounds(scene(), scene().calibration, 0.2))
    for name in (OURS, "ukf_arclength", "sqrf_direction"):
        sd = tracks()[name].sd.mean(axis=0)
        np.testing.assert_allclose(sd[20:] / least[20:], 1.0, atol=0.05)
        z = tracks()[name].error[:, -1] / least[-1]
        assert within((z**2).mean(), RUNS), name


def test_inner_products_waste_information_and_do_not_know() -> None:
    rms = {n: np.sqrt((t.error[:, 30:] ** 2).mean(axis=(0, 1))) for n, t in tracks().items()}
    assert (rms[PAPER] / rms[OURS]).mean() > 1.15
    paper = tracks()[PAPER]
    assert np.sqrt(((paper.error / paper.sd)[:, -1] ** 2).mean()) > 1.3
    assert (paper.sd[:, -1] < tracks()[OURS].sd[:, -1]).mean() > 0.8


def test_noise_levels_have_the_same_draws() -> None:
    half = calibrate(
        scene(), scene().calibration, CentroidNoise(0.1), (OURS,), MonteCarlo(RUNS, Draws(5))
    )[OURS]
    for k in range(5):
        pair = (half.error[:, -1, k], tracks()[OURS].error[:, -1, k])
        assert np.corrcoef(*pair)[0, 1] > 0.95
        assert np.std(pair[1]) / np.std(pair[0]) == pytest.approx(2.0, rel=0.15)


def test_runs_depend_on_seed_and_number_alone() -> None:
    images = scene().calibration.between(0, 12)
    one = calibrate(scene(), images, CentroidNoise(), (OURS,), MonteCarlo(3, Draws(5)))[OURS]
    both = calibrate(scene(), images, CentroidNoise(), (PAPER, OURS), MonteCarlo(2, Draws(5)))[OURS]
    np.testing.assert_array_equal(one.error[:2], both.error)
    np.testing.assert_array_equal(one.error, tracks()[OURS].error[:3, :12])
    other = calibrate(scene(), images, CentroidNoise(), (OURS,), MonteCarlo(1, Draws(6)))[OURS]
    assert not np.allclose(other.error[0], one.error[0])


def test_image_error_is_what_no_turn_explains() -> None:
    """Move the camera, fit the attitude, and look how far the stars still are off."""
    grid, form = grid_over(scene().true), image_form(scene())
    error = 1e-2 * scene().scale * np.array([1.0, -2.0, 1.5, 0.5, -1.0])
    moved = scene().true.with_parameters(scene().true.parameters + error)
    s = moved.directions(grid.row_px, grid.col_px)
    ones = np.ones(len(s))
    c = solve_wahba(s, grid.s_i, ones, grid.image, 1)[0]
    row, col = moved.project(grid.s_i @ c.T)
    left = np.stack([row - grid.row_px, col - grid.col_px], axis=1)
    assert error @ form @ error == pytest.approx(0.5 * (left**2).sum(axis=1).mean(), rel=0.02)
    linear = np.einsum("kip,p->ki", without_turn(scene().true, grid), error)
    np.testing.assert_allclose(linear, left, atol=0.03 * np.abs(left).max())


def test_published_coefficients_make_thepublished_corner() -> None:
    corner = published_corner(scene(), grid_over(scene().true))
    assert corner == pytest.approx(published()["largest_distortion_px"], abs=0.01)


def test_the_mounting_is_matrix_52() -> None:
    c_sb = true_mounting()
    np.testing.assert_allclose(c_sb @ c_sb.T, np.eye(3), atol=1e-12)
    assert c_sb[0, 1] == pytest.approx(0.017449, abs=1e-6)
    assert c_sb[2, 0] == pytest.approx(0.017751, abs=1e-6)
    assert published()["printed"]["diagonal"] == pytest.approx(3.3e-6, abs=1e-7)
    assert max(map(abs, published()["printed"]["angles_deg"])) == pytest.approx(0.0076, abs=1e-4)


@cache
def mountings() -> dict[str, dict[str, Mountings]]:
    return align_all(scene(), tracks(), MonteCarlo(RUNS, Draws(5)))


def test_the_second_stage_knows_its_error_with_the_true_camera() -> None:
    for name in ("linear", "multiplicative"):
        found = mountings()[TRUE][name]
        turn = vector_from_matrix(found.matrix[:, -1] @ scene().c_sb.T)
        inverse = np.linalg.inv(found.covariance[:, -1])
        nees = np.einsum("ri,rij,rj->r", turn, inverse, turn)
        assert within(nees.sum() / (3 * RUNS), 3 * RUNS), name


def test_the_cameras_error_is_the_mountings_error() -> None:
    found = mountings()[OURS]["multiplicative"]
    turn = vector_from_matrix(found.matrix[:, -1] @ scene().c_sb.T)
    whole = found.covariance[:, -1] + found.by_camera
    nees = np.einsum("ri,rij,rj->r", turn, np.linalg.inv(whole), turn)
    assert within(nees.sum() / (3 * RUNS), 3 * RUNS)
    # Every run has its own camera.
    expected = np.sqrt(np.diagonal(whole, axis1=1, axis2=2).mean(axis=0))
    np.testing.assert_allclose(turn.std(axis=0) / expected, 1.0, atol=0.5)
    own = np.diagonal(found.covariance[:, -1], axis1=1, axis2=2)
    assert np.sqrt((turn**2 / own).mean()) > 5.0


def test_turn_by_camera_against_wahba() -> None:
    images = scene().alignment
    s = scene().true.directions(images.row_px, images.col_px)
    for k in range(5):
        error = np.zeros(5)
        error[k] = 1e-3 * scene().scale[k]
        moved = scene().true.with_parameters(scene().true.parameters + error)
        seen = moved.directions(images.row_px, images.col_px)
        c = solve_wahba(seen, s, np.ones(len(s)), np.zeros(len(s), int), 1)
        turn = vector_from_matrix(c)[0]
        found = turn_by_camera(scene(), scene().true, np.outer(error, error))
        np.testing.assert_allclose(found, np.outer(turn, turn), rtol=1e-3, atol=1e-3 * turn @ turn)


def test_nine_elements_are_a_filter_frame_by_frame() -> None:
    """Eqs (49)-(51) as printed, image after image, from a prior that says nothing."""
    rng = np.random.default_rng(2)
    images = scene().alignment.between(0, 6)
    s_b = np.einsum("kij,kj->ki", scene().c_bi[images.image], images.s_i)
    s_s = s_b @ scene().c_sb.T + 5e-5 * rng.normal(size=s_b.shape)
    sd = np.full(len(s_b), 5e-5)
    sightings = Sightings(s_s, s_b, sd, images.image, np.zeros((6, 3, 3)))
    x, P = np.zeros(9), 1e6 * np.eye(9)
    for k in range(len(s_b)):
        H = np.kron(np.eye(3), s_b[k])
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + sd[k] ** 2 * np.eye(3))
        x, P = x + K @ (s_s[k] - H @ x), (np.eye(9) - K @ H) @ P
    found = nine_elements(sightings, np.array([2, 6]))
    np.testing.assert_allclose(found[1], x.reshape(3, 3), atol=1e-5)
    assert not np.allclose(found[1] @ found[1].T, np.eye(3), atol=1e-6)
    assert np.isnan(mountings()[TRUE][NINE].covariance).all()


def test_where_curves_are_read() -> None:
    t_s = np.arange(11.0)
    assert image_at(t_s, 3.0) == 3
    assert image_at(t_s, 3.9) == 3
    assert image_at(t_s, 300.0) == 10
    assert list(shown_images(5)) == [0, 1, 2, 3, 4]
    assert shown_images(1000)[-1] == 999
    assert stops_of(scene())[-1] == scene().alignment.n_images
    curve = np.array([9.0, 0.5, -2.0, 0.5, -0.5, 0.1])
    assert settled_s(t_s[:6], curve, 1.0) == 3.0
    assert settled_s(t_s[:6], curve, 10.0) == 0.0
    assert np.isnan(settled_s(t_s[:6], curve, 0.05))
    assert np.isnan(settled_s(t_s[:2], np.array([0.0, np.nan]), 1.0))


def test_another_sensor_is_refused() -> None:
    scenario = load_scenario(ROOT / "configs" / "scenarios" / "st16-1.toml")
    with pytest.raises(ConfigError, match="pixel-radial"):
        make_scene(scenario, 10.0, 10.0)
    found = load_scenario(SCENARIO)
    section = found.sensor.catalogue.model_copy(update={"limiting_magnitude": 3.0})
    blind = scenario_with(found, sensor=found.sensor.model_copy(update={"catalogue": section}))
    with pytest.raises(ConfigError, match="limiting magnitude 3"):
        make_scene(blind, 10.0, 10.0)
