import numpy as np
import pytest
from conftest import simulation, st16_matcher
from scipy.spatial.transform import Rotation

from stcal.attitude import (
    attitude_covariance,
    attitudes_from_quaternions,
    better_exposure,
    frame_quaternions,
    mean_rotation,
    solve_wahba,
    unweighted_covariance,
)
from stcal.geometry.rotations import nearest_rotation
from stcal.matching import match


def field(rng, count, width=0.15):
    """Unit vectors around the boresight."""
    v = np.column_stack([rng.uniform(-width, width, (count, 2)), np.ones(count)])
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def test_wahba_agrees_with_scipy_exposure_by_exposure():
    rng = np.random.default_rng(2)
    counts = np.array([5, 2, 30, 0, 7])
    exposure = np.repeat(np.arange(5), counts)
    truth = Rotation.random(5, rng=rng)
    s_d = field(rng, counts.sum())
    s_i = truth[exposure].inv().apply(s_d) + rng.normal(0, 1e-4, s_d.shape)
    s_i /= np.linalg.norm(s_i, axis=1, keepdims=True)
    weight = rng.uniform(0.5, 2.0, len(s_d))
    found = solve_wahba(s_d, s_i, weight, exposure, 5)
    for e in (0, 1, 2, 4):
        mine = exposure == e
        peer, _ = Rotation.align_vectors(s_d[mine], s_i[mine], weights=weight[mine])
        np.testing.assert_allclose(found[e], peer.as_matrix(), atol=1e-9)
    assert np.isnan(found[3]).all()


def test_wahba_returns_proper_rotations_for_two_stars():
    rng = np.random.default_rng(3)
    s_d = field(rng, 40)
    exposure = np.repeat(np.arange(20), 2)
    s_i = Rotation.random(20, rng=rng)[exposure].inv().apply(s_d)
    found = solve_wahba(s_d, s_i, np.ones(40), exposure, 20)
    np.testing.assert_allclose(np.linalg.det(found), 1.0, atol=1e-12)


def needle(rng, count):
    """Stars on a line across the field, and one a little beside it."""
    v = np.column_stack([np.linspace(-0.1, 0.15, count), np.full(count, 0.02), np.ones(count)])
    v[0, 1] += 1e-3
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def sphere(rng, count):
    v = rng.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


@pytest.mark.parametrize(
    ("stars", "noise"),
    [
        (lambda rng: field(rng, 10), 1e-4),
        (lambda rng: field(rng, 2), 1e-4),
        (lambda rng: field(rng, 2, 1e-3), 1e-6),
        (lambda rng: needle(rng, 5), 1e-4),
        (lambda rng: sphere(rng, 2), 1e-3),
        (lambda rng: sphere(rng, 20), 1e-2),
        (lambda rng: np.vstack([np.eye(3), -np.eye(3)]), 1e-3),
        # False stars: the best attitude may be a reflection but for the determinant.
        (lambda rng: field(rng, 5), 0.2),
        (lambda rng: sphere(rng, 6), 1.0),
    ],
)
def test_wahba_is_the_svds_solution(stars, noise):
    """To 1e-12 rad, or to what rounding of the profile itself does to close stars."""
    rng = np.random.default_rng(9)
    sets = [stars(rng) for _ in range(200)]
    exposure = np.repeat(np.arange(200), [len(s) for s in sets])
    s_d, weight = np.concatenate(sets), rng.uniform(0.5, 2.0, len(exposure))
    s_i = Rotation.random(200, rng=rng)[exposure].inv().apply(s_d)
    s_i += rng.normal(0, noise, s_i.shape)
    s_i /= np.linalg.norm(s_i, axis=1, keepdims=True)
    profile = np.zeros((200, 3, 3))
    np.add.at(profile, exposure, weight[:, None, None] * s_d[:, :, None] * s_i[:, None, :])
    values = np.linalg.svd(profile, compute_uv=False)
    values[:, 2] *= np.sign(np.linalg.det(profile))
    rounding = 4.0 * np.finfo(float).eps * values[:, 0] / (values[:, 1] + values[:, 2])
    found = solve_wahba(s_d, s_i, weight, exposure, 200)
    apart = np.linalg.norm(found - nearest_rotation(profile), axis=(1, 2))
    assert (apart < np.maximum(1e-12, rounding)).all()
    np.testing.assert_allclose(np.linalg.det(found), 1.0, atol=1e-14)


def test_covariance_is_the_inverse_information_or_nan():
    rng = np.random.default_rng(10)
    s_d = np.concatenate([field(rng, 6), field(rng, 1), np.tile(field(rng, 1), (2, 1))])
    exposure = np.array([0] * 6 + [1] + [2] * 2)
    sd = rng.uniform(1e-5, 1e-4, len(s_d))
    found = attitude_covariance(s_d, sd, exposure, 4)
    total = sum((np.eye(3) - np.outer(s, s)) / e**2 for s, e in zip(s_d[:6], sd[:6], strict=True))
    np.testing.assert_allclose(found[0] @ total, np.eye(3), atol=1e-12)
    assert np.isnan(found[1:]).all()


def test_covariance_matches_monte_carlo():
    rng = np.random.default_rng(4)
    s_d, sd, runs = field(rng, 8), np.full(8, 1e-4), 4000
    exposure = np.repeat(np.arange(runs), 8)
    many = np.tile(s_d, (runs, 1))
    noisy = many + rng.normal(0, 1e-4, many.shape)
    noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
    found = solve_wahba(noisy, many, np.ones(len(many)), exposure, runs)
    error = Rotation.from_matrix(found).as_rotvec()
    predicted = attitude_covariance(s_d, sd, np.zeros(8, int), 1)[0]
    np.testing.assert_allclose(np.cov(error.T), predicted, rtol=0.1, atol=3e-10)
    assert error.mean(axis=0) == pytest.approx(0, abs=5e-6)


def test_covariance_of_the_unweighted_solution_matches_monte_carlo():
    rng = np.random.default_rng(6)
    s_d, runs = field(rng, 8), 4000
    sd = np.where(np.arange(8) < 4, 2e-5, 2e-4)
    exposure = np.repeat(np.arange(runs), 8)
    many = np.tile(s_d, (runs, 1))
    noisy = many + rng.normal(0, 1.0, many.shape) * np.tile(sd, runs)[:, None]
    noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
    found = solve_wahba(noisy, many, np.ones(len(many)), exposure, runs)
    error = Rotation.from_matrix(found).as_rotvec()
    predicted = unweighted_covariance(s_d, sd, np.zeros(8, int), 1)[0]
    spread = np.sqrt(np.diag(predicted))
    scale = np.outer(spread, spread)
    np.testing.assert_allclose(np.cov(error.T) / scale, predicted / scale, atol=0.1)
    better = attitude_covariance(s_d, sd, np.zeros(8, int), 1)[0]
    assert (np.diag(better) < 0.5 * np.diag(predicted)).all()


def test_mean_rotation_judges_each_axis_by_its_own_spread():
    """Ten of 200 rotations are 30 sd off in x, well inside the spread of the roll."""
    rng = np.random.default_rng(7)
    vectors = rng.normal(0, [1e-5, 1e-5, 1e-4], (200, 3))
    vectors[::20, 0] += 3e-4
    mean = mean_rotation(Rotation.from_rotvec(vectors).as_matrix())
    assert not mean.kept[::20].any()
    assert abs(Rotation.from_matrix(mean.c).as_rotvec()[0]) < 4e-6


def test_sd_of_the_mean_allows_for_correlated_neighbours():
    rng = np.random.default_rng(8)
    independent = rng.normal(0, 1e-4, (2000, 3))
    slow = np.repeat(rng.normal(0, 1e-4, (200, 3)), 10, axis=0)
    for vectors, count in ((independent, 2000), (slow, 200)):
        mean = mean_rotation(Rotation.from_rotvec(vectors).as_matrix())
        np.testing.assert_allclose(mean.sd_of_mean, 1e-4 / np.sqrt(count), rtol=0.4)


def test_quaternion_convention_is_scipys():
    """A(q) takes I to S, so that Rotation.from_quat(q).apply(v_S) == v_I."""
    data = simulation(5, 1, 30)
    c_sd = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
    matched = match(data.calibration.frames, data.true.camera, c_sd, st16_matcher())
    q_si, best = frame_quaternions(matched, c_sd)
    frame = int(np.flatnonzero(best >= 0)[0])
    star = matched.is_matched & (matched.frames.exposure_of_star == 2 * frame + best[frame])
    s_d = data.true.camera.directions(matched.frames.row_px[star], matched.frames.col_px[star])
    turned = Rotation.from_quat(q_si[frame]).apply(s_d @ c_sd.T)
    np.testing.assert_allclose(turned, matched.s_i[star], atol=5e-4)
    back = attitudes_from_quaternions(q_si, c_sd)
    np.testing.assert_allclose(back[frame], matched.c_di[2 * frame + best[frame]], atol=1e-12)
    assert np.isnan(back[best < 0]).all()


def test_better_exposure_prefers_matches_then_residuals():
    data = simulation(5, 1, 30)
    matched = match(data.calibration.frames, data.true.camera, np.eye(3), st16_matcher())
    best = better_exposure(matched)
    counts = np.where(matched.solved, matched.matches_per_exposure, 0).reshape(-1, 2)
    chosen = best >= 0
    assert (counts[chosen, best[chosen]] == counts[chosen].max(axis=1)).all()
    assert (best[counts.max(axis=1) == 0] == -1).all()
    square = np.bincount(
        matched.frames.exposure_of_star,
        np.nan_to_num(matched.residual) ** 2,
        minlength=2 * len(best),
    ).reshape(-1, 2)
    tied = chosen & (counts[:, 0] == counts[:, 1])
    assert tied.any()
    assert (square[tied, best[tied]] <= square[tied, 1 - best[tied]]).all()


def test_mean_rotation_survives_one_false_solution_of_140_degrees():
    rng = np.random.default_rng(5)
    truth = Rotation.from_rotvec([0.01, -0.02, 0.03])
    good = truth * Rotation.from_rotvec(rng.normal(0, 2e-4, (100, 3)))
    false = Rotation.from_rotvec(np.radians(140) * np.array([0.6, 0.8, 0.0])) * truth
    mean = mean_rotation(np.concatenate([good.as_matrix(), false.as_matrix()[None]]))
    off = (Rotation.from_matrix(mean.c) * truth.inv()).magnitude()
    assert off < 8e-5  # four sd of the mean
    assert not mean.kept[-1]
    assert mean.kept[:-1].sum() >= 99
    np.testing.assert_allclose(mean.spread, 2e-4, rtol=0.25)
    plain = Rotation.concatenate([good, false]).mean()
    assert (plain * truth.inv()).magnitude() > 10 * off


def test_mean_rotation_of_nothing_is_none():
    assert mean_rotation(np.empty((0, 3, 3))) is None
