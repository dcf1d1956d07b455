"""The misalignment filters against truth, Wahba's solution, and the paper's own recursion."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stcal.attitude import solve_wahba
from stcal.estimators.misalignment import (
    MISALIGNMENT,
    Sightings,
    frame_innovations,
    linear,
    multiplicative,
    nearest_rotation,
)
from stcal.geometry.rotations import vector_from_matrix

# Zhang et al. 2024 eq (52), as printed.
PAPER = np.array(
    [
        [0.999695, 0.017449, -0.017452],
        [-0.017145, 0.999700, 0.017449],
        [0.017751, -0.017145, 0.999695],
    ]
)
TRUTH = Rotation.from_rotvec([0.5, -1.2, 2.0]).as_matrix()
HALF_FIELD = 0.12
NO_NOISE = np.zeros((3, 3))
NOISES = {
    "exact attitudes": NO_NOISE,
    "equal": np.eye(3) * 1e-8,
    "unequal": np.array([[4.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 40.0]]) * 1e-8,
}


def simulated(rng, frames, sd=1e-4, attitude=NO_NOISE, c_sb=TRUTH):
    """Stars of a 14-degree field; noise of the stars in the tangent plane, frames turned."""
    frame = np.repeat(np.arange(frames), rng.integers(4, 15, frames))
    w = np.column_stack(
        [rng.uniform(-HALF_FIELD, HALF_FIELD, (len(frame), 2)), np.ones(len(frame))]
    )
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    error = Rotation.from_rotvec(rng.multivariate_normal(np.zeros(3), attitude, frames))
    each = sd * rng.uniform(0.5, 2.0, len(frame))
    measured = w + np.cross(w, rng.normal(size=w.shape)) * each[:, None]
    measured /= np.linalg.norm(measured, axis=1, keepdims=True)
    s_b = error[frame].apply(w @ c_sb)
    return Sightings(measured, s_b, each, frame, np.tile(attitude, (frames, 1, 1)))


def last(method, sightings):
    found = method(sightings, np.array([sightings.n_frames]))
    return found.c_sb[0], found.covariance[0]


def wahba(sightings):
    together = np.zeros(len(sightings.sd), dtype=int)
    return solve_wahba(sightings.s_s, sightings.s_b, sightings.sd**-2.0, together, 1)[0]


@pytest.mark.parametrize("name", MISALIGNMENT)
@pytest.mark.parametrize("truth", [TRUTH, nearest_rotation(PAPER)])
def test_without_noise_both_are_wahbas_solution_and_the_truth(name, truth):
    rng = np.random.default_rng(1)
    exact = simulated(rng, 20, sd=1e-4, c_sb=truth)
    w = exact.s_b @ truth.T
    sightings = Sightings(w, exact.s_b, exact.sd, exact.frame, exact.attitude_covariance)
    c_sb, _ = last(MISALIGNMENT[name], sightings)
    np.testing.assert_allclose(c_sb, truth, atol=1e-12)
    np.testing.assert_allclose(c_sb, wahba(sightings), atol=1e-12)


@pytest.mark.parametrize("name", MISALIGNMENT)
def test_every_estimate_is_a_rotation(name):
    sightings = simulated(np.random.default_rng(2), 40, attitude=NOISES["equal"])
    found = MISALIGNMENT[name](sightings, np.arange(1, 41))
    square = found.c_sb @ np.swapaxes(found.c_sb, 1, 2)
    np.testing.assert_allclose(square, np.tile(np.eye(3), (40, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(found.c_sb), 1.0, atol=1e-12)


def test_without_attitude_noise_the_multiplicative_filter_is_wahbas_solution():
    sightings = simulated(np.random.default_rng(3), 40)
    c_sb, covariance = last(multiplicative, sightings)
    apart = vector_from_matrix((c_sb @ wahba(sightings).T)[None])[0]
    assert (np.abs(apart) < 1e-4 * np.sqrt(np.diag(covariance))).all()
    assert np.abs(apart).max() < 1e-10


def test_the_linear_filter_is_the_papers_recursion():
    """Eqs (44)-(51) star by star from a matrix of zeros of which nothing is known."""
    sightings = simulated(np.random.default_rng(4), 15, attitude=NOISES["equal"])
    x, p = np.zeros(9), np.eye(9) * 1e4
    for w, v, sd in zip(sightings.s_s, sightings.s_b, sightings.sd, strict=True):
        h = np.kron(np.eye(3), v)
        gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + sd**2 * np.eye(3))
        x = x + gain @ (w - h @ x)
        p = (np.eye(9) - gain @ h) @ p
    c_sb, covariance = last(linear, sightings)
    apart = vector_from_matrix((c_sb @ nearest_rotation(x.reshape(3, 3)).T)[None])[0]
    assert (np.abs(apart) < 1e-3 * np.sqrt(np.diag(covariance))).all()


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("name", MISALIGNMENT)
def test_errors_are_those_of_the_covariance_at_every_stop(name, noise):
    rng = np.random.default_rng(5)
    runs, stops = 300, np.array([5, 20, 60])
    errors, covariances = np.empty((runs, 3, 3)), np.empty((runs, 3, 3, 3))
    for run in range(runs):
        found = MISALIGNMENT[name](simulated(rng, 60, attitude=NOISES[noise]), stops)
        errors[run], covariances[run] = vector_from_matrix(found.c_sb @ TRUTH.T), found.covariance
    ratio = errors / np.sqrt(np.diagonal(covariances, axis1=2, axis2=3))
    # 300 runs leave 4 % of uncertainty.
    np.testing.assert_allclose(np.sqrt((ratio**2).mean(axis=0)), 1.0, atol=0.13)
    weighted = np.linalg.solve(covariances, errors[..., None])[..., 0]
    nees = (errors * weighted).sum(axis=2).mean(axis=0)
    np.testing.assert_allclose(nees, 3.0, atol=0.45)


def test_what_the_papers_gain_costs():
    """A sixth of the sd across the boresight, and in roll what its independent stars overlook."""
    rng = np.random.default_rng(6)
    errors = {
        (name, noise): np.empty((200, 3)) for name in MISALIGNMENT for noise in ("exact", "noisy")
    }
    for run in range(200):
        for noise, attitude in (("exact", NO_NOISE), ("noisy", np.eye(3) * 4e-8)):
            sightings = simulated(rng, 40, attitude=attitude)
            for name, method in MISALIGNMENT.items():
                turn = last(method, sightings)[0] @ TRUTH.T
                errors[name, noise][run] = vector_from_matrix(turn[None])[0]
    rms = {key: np.sqrt((found**2).mean(axis=0)) for key, found in errors.items()}
    exact = rms["linear", "exact"] / rms["multiplicative", "exact"]
    noisy = rms["linear", "noisy"] / rms["multiplicative", "noisy"]
    assert 1.08 < exact[:2].mean() < 1.28
    assert exact[2] == pytest.approx(1.0, abs=0.03)
    assert 1.8 < noisy[2] < 2.8


def test_the_filters_own_covariance_would_be_wrong():
    """With sd^2 1 it claims noise along the star vector: 6 times too much across the boresight."""
    sightings = simulated(np.random.default_rng(7), 60)
    c_sb, covariance = last(linear, sightings)
    inverse = np.linalg.inv((sightings.s_b.T * sightings.sd**-2.0) @ sightings.s_b)
    own = c_sb @ inverse @ c_sb.T
    # Each row of the matrix has ``own``: e = 1/2 (E_zy - E_yz) and so on.
    claimed = 0.5 * np.sqrt(own.diagonal()[[1, 2, 0]] + own.diagonal()[[2, 0, 1]])
    found = np.sqrt(np.diag(covariance))
    assert (claimed[:2] > 4.0 * found[:2]).all()
    assert claimed[2] == pytest.approx(found[2], rel=0.05)


@pytest.mark.parametrize("name", MISALIGNMENT)
def test_earlier_estimates_are_those_of_the_first_frames_alone(name):
    sightings = simulated(np.random.default_rng(8), 50, attitude=NOISES["unequal"])
    found = MISALIGNMENT[name](sightings, np.array([12, 30, 50]))
    for k, stop in enumerate((12, 30)):
        c_sb, covariance = last(MISALIGNMENT[name], sightings.take(np.arange(50) < stop))
        apart = vector_from_matrix((found.c_sb[k] @ c_sb.T)[None])[0]
        assert (np.abs(apart) < 1e-2 * np.sqrt(np.diag(covariance))).all()
        scale = np.sqrt(np.outer(covariance.diagonal(), covariance.diagonal()))
        np.testing.assert_allclose(found.covariance[k] / scale, covariance / scale, atol=1e-2)


def test_frames_without_attitude_noise_count_for_more():
    """Half of the attitudes are useless: the estimate is that of the good half."""
    rng = np.random.default_rng(9)
    good = simulated(rng, 30)
    bad = simulated(rng, 30, attitude=np.eye(3) * 1e-4)
    both = Sightings(
        np.concatenate([good.s_s, bad.s_s]),
        np.concatenate([good.s_b, bad.s_b]),
        np.concatenate([good.sd, bad.sd]),
        np.concatenate([good.frame, bad.frame + 30]),
        np.concatenate([good.attitude_covariance, bad.attitude_covariance]),
    )
    alone, covariance = last(multiplicative, good)
    together, _ = last(multiplicative, both)
    apart = vector_from_matrix((together @ alone.T)[None])[0]
    assert (np.abs(apart) < 0.3 * np.sqrt(np.diag(covariance))).all()
    assert np.abs(vector_from_matrix((last(linear, both)[0] @ alone.T)[None])).max() > 1e-4


@pytest.mark.parametrize("noise", NOISES)
def test_innovations_are_consistent(noise):
    sightings = simulated(np.random.default_rng(10), 2000, attitude=NOISES[noise])
    found = frame_innovations(sightings, TRUTH)
    assert found.nis.mean() == pytest.approx(3.0, abs=0.2)
    assert found.star_chi2.sum() / found.freedom.sum() == pytest.approx(1.0, abs=0.04)
    spread = found.rotation / np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    np.testing.assert_allclose(spread.std(axis=0), 1.0, atol=0.06)


def test_the_innovation_is_the_frames_own_rotation():
    sightings = simulated(np.random.default_rng(11), 5)
    turn = np.array([2e-4, -1e-4, 3e-4])
    shifted = frame_innovations(sightings, Rotation.from_rotvec(-turn).as_matrix() @ TRUTH)
    plain = frame_innovations(sightings, TRUTH)
    np.testing.assert_allclose(shifted.rotation - plain.rotation, np.tile(turn, (5, 1)), atol=3e-7)


def test_the_printed_matrix_is_not_quite_a_rotation():
    assert 1e-8 < np.abs(PAPER @ PAPER.T - np.eye(3)).max() < 3e-6
    c_sb = nearest_rotation(PAPER)
    np.testing.assert_allclose(c_sb @ c_sb.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(c_sb, PAPER, atol=2e-6)


def test_the_nearest_rotation_is_no_reflection():
    found = nearest_rotation(np.diag([1.0, 1.0, -0.1]))
    assert np.linalg.det(found) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("name", MISALIGNMENT)
def test_the_papers_accuracy_within_its_200_seconds(name):
    """0.2 px of 18 um at 74 mm, a frame a second: the paper has 4.4e-5 and 0.0076 degrees."""
    truth = nearest_rotation(PAPER)
    sightings = simulated(np.random.default_rng(12), 200, sd=0.2 * 18e-6 / 74e-3, c_sb=truth)
    c_sb, _ = last(MISALIGNMENT[name], sightings)
    assert np.abs(c_sb - truth).mean() < 4.4e-5
    angle = vector_from_matrix((c_sb @ truth.T)[None])[0]
    assert np.abs(angle).mean() < np.radians(0.0076)
