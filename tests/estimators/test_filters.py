"""The update and time steps of the sequential estimators against dense formulas."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stcal.estimators.filter_kernels import sigma_points, triangularise
from stcal.estimators.sequential import SEQUENTIAL

LINEAR = ["ekf", "sqrf", "smoother"]
ALL = [*LINEAR, "ukf"]


@dataclass
class Problem:
    """y = H d + v with d ~ N(0, P) and v ~ N(0, 1), about the state x."""

    x: np.ndarray
    P: np.ndarray
    H: np.ndarray
    y: np.ndarray

    @property
    def rows(self):
        return np.ascontiguousarray(np.column_stack([self.H, self.y]))


def make_problem(n, rows, seed, empty=0.0, spread=2.0):
    """A random problem; a share ``empty`` of its rows say nothing, as dependent arcs do."""
    rng = np.random.default_rng(seed)
    basis = np.linalg.qr(rng.normal(size=(n, n)))[0]
    P = basis @ np.diag(10.0 ** rng.uniform(-spread, spread, n)) @ basis.T
    said = (rng.random(rows) >= empty)[:, None]
    H = rng.normal(size=(rows, n)) * said
    y = 3.0 * rng.normal(size=rows) * said[:, 0]
    return Problem(rng.normal(size=n), 0.5 * (P + P.T), H, y)


def root_of(method, P):
    """The estimator's own root of a covariance."""
    if method == "ekf":
        return P.copy()
    if method == "smoother":
        return np.linalg.cholesky(np.linalg.inv(P)).T.copy()
    return np.linalg.cholesky(P).T.copy()


def covariance_of(method, root):
    P = np.empty_like(root)
    SEQUENTIAL[method].covariance(root, P)
    return P


def update(method, problem, precision="double"):
    """State, covariance, innovations, NIS and log det after an update."""
    n, count = len(problem.x), len(problem.y)
    x, root = problem.x.copy(), root_of(method, problem.P)
    points, values = np.empty((2 * n + 1, n)), np.empty((count, 2 * n + 1))
    if method == "ukf":
        sigma_points(x, root, points)
        values[:] = problem.H @ (points - x).T - problem.y[:, None]
    innovation, score = np.full(count, np.nan), np.zeros(2)
    SEQUENTIAL[method].steps[precision].update(problem.rows, values, x, root, innovation, score)
    return x, covariance_of(method, root), innovation, score, root


def dense(problem):
    """Enright 2018 eqs (25)-(27) as they stand, with R = 1, and the innovations' density."""
    x, P, H, y = problem.x, problem.P, problem.H, problem.y
    S = H @ P @ H.T + np.eye(len(y))
    K = np.linalg.solve(S, H @ P).T
    innovation = np.linalg.solve(np.linalg.cholesky(S), y)
    score = [y @ np.linalg.solve(S, y), np.linalg.slogdet(S)[1]]
    return x + K @ y, P - K @ H @ P, innovation, score


shapes = {
    "n": st.integers(1, 9),
    "rows": st.integers(0, 40),
    "seed": st.integers(0, 2**32 - 1),
    "empty": st.sampled_from([0.0, 0.2, 1.0]),
}


@pytest.mark.parametrize("method", ALL)
@given(**shapes)
@settings(deadline=None, max_examples=60)
def test_updates_equal_the_dense_formulas(method, n, rows, seed, empty):
    problem = make_problem(n, rows, seed, empty)
    x, P, innovation, score, _ = update(method, problem)
    expected = dense(problem)
    sd = np.sqrt(np.diag(problem.P))
    np.testing.assert_allclose(x / sd, expected[0] / sd, atol=1e-8)
    # Compared along the prior's axes: some directions shrink by a factor of a million.
    white = np.linalg.inv(np.linalg.cholesky(problem.P))
    found, wanted = (white @ each @ white.T for each in (P, expected[1]))
    np.testing.assert_allclose(found, wanted, atol=1e-9)
    np.testing.assert_allclose(innovation, expected[2], atol=1e-8)
    np.testing.assert_allclose(score, expected[3], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("method", ALL)
def test_no_measurement_changes_nothing(method):
    problem = make_problem(5, 0, seed=3)
    x, P, _, score, root = update(method, problem)
    assert np.array_equal(x, problem.x)
    np.testing.assert_allclose(root, root_of(method, problem.P), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(P, problem.P, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(score, 0.0, atol=1e-12)


@pytest.mark.parametrize("method", ALL)
def test_rows_taken_in_two_updates_give_the_same_state(method):
    """Only for linear measurements, of course; a filter that keeps something back would fail."""
    problem = make_problem(6, 20, seed=8)
    whole = update(method, problem)
    first = Problem(problem.x, problem.P, problem.H[:7], problem.y[:7])
    x, P, early, before, _ = update(method, first)
    rest = problem.y[7:] - problem.H[7:] @ (x - problem.x)
    x, P, late, after, _ = update(method, Problem(x, P, problem.H[7:], rest))
    np.testing.assert_allclose(x, whole[0], rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(P, whole[1], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(np.concatenate([early, late]), whole[2], rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(before + after, whole[3], rtol=1e-9)


@pytest.mark.parametrize("method", ["sqrf", "ukf"])
def test_square_roots_stay_triangular(method):
    """The root is S^T of P = S S^T."""
    *_, root = update(method, make_problem(7, 30, seed=4))
    assert np.array_equal(root, np.triu(root))
    assert (np.diag(root) > 0).all()


def test_innovations_are_standardised():
    """Of a consistent problem: independent, unit variance."""
    rng = np.random.default_rng(5)
    problem = make_problem(4, 6, seed=5, spread=1.0)
    S = problem.H @ problem.P @ problem.H.T + np.eye(6)
    root = np.linalg.cholesky(S)
    found = []
    for _ in range(4000):
        problem.y = root @ rng.normal(size=6)
        found.append(update("sqrf", problem)[2])
    covariance = np.cov(np.array(found).T)
    np.testing.assert_allclose(covariance, np.eye(6), atol=0.12)


def quadratic(n, seed):
    rng = np.random.default_rng(seed)
    C = rng.normal(size=(n, n))
    return rng.normal(), rng.normal(size=n), 0.1 * (C + C.T)


@pytest.mark.parametrize("n", [1, 2, 5, 8])
def test_the_unscented_update_of_a_quadratic_function(n):
    """h(x) = a + b x + x C x: what the points x +- sqrt(n) S_k with alpha = 1, kappa = 0, beta = 2
    make of it follows in closed form; the mean a + b m + m C m + tr(C P) is the exact one."""
    a, b, C = quadratic(n, seed=n)
    problem = make_problem(n, 0, seed=20 + n, spread=0.5)
    x, root = problem.x.copy(), root_of("ukf", problem.P)
    points = np.empty((2 * n + 1, n))
    sigma_points(x, root, points)
    measured = 2.5
    values = (a + points @ b + np.einsum("pi,ij,pj->p", points, C, points) - measured)[None]
    innovation, score = np.empty(1), np.empty(2)
    SEQUENTIAL["ukf"].steps["double"].update(
        np.empty((1, n + 1)), np.ascontiguousarray(values), x, root, innovation, score
    )
    m, P = problem.x, problem.P
    mean = a + b @ m + m @ C @ m + np.trace(C @ P)
    slope = b + 2.0 * C @ m
    S = np.linalg.cholesky(P)
    along = np.einsum("ik,ij,jk->k", S, C, S)
    variance = 1.0 + slope @ P @ slope + np.trace(C @ P) ** 2 + n * (along**2).sum()
    if n == 1:
        assert variance == pytest.approx(1.0 + slope @ P @ slope + 2.0 * np.trace(C @ P @ C @ P))
    assert innovation[0] == pytest.approx((measured - mean) / np.sqrt(variance), rel=1e-12)
    assert score[1] == pytest.approx(np.log(variance), rel=1e-12)
    np.testing.assert_allclose(x, m + P @ slope * (measured - mean) / variance, rtol=1e-12)
    expected = P - np.outer(P @ slope, P @ slope) / variance
    np.testing.assert_allclose(covariance_of("ukf", root), expected, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("method", ["ekf", "sqrf", "ukf"])
@given(n=st.integers(1, 9), seed=st.integers(0, 2**32 - 1), still=st.booleans())
@settings(deadline=None, max_examples=40)
def test_the_time_update_adds_the_process_noise(method, n, seed, still):
    problem = make_problem(n, 0, seed)
    noise_sd = np.random.default_rng(seed).uniform(0.0, 3.0, n)
    noise_sd[::2] *= 0.0 if still else 1.0
    root = root_of(method, problem.P)
    SEQUENTIAL[method].steps["double"].predict(root, noise_sd)
    expected = problem.P + np.diag(noise_sd**2)
    np.testing.assert_allclose(covariance_of(method, root), expected, rtol=1e-11, atol=1e-11)


def test_the_smoothers_parameters_are_constants():
    root = root_of("smoother", make_problem(4, 0, seed=1).P)
    before = root.copy()
    SEQUENTIAL["smoother"].steps["double"].predict(root, np.ones(4))
    assert np.array_equal(root, before)


@given(
    n=st.integers(1, 8),
    extra=st.integers(0, 12),
    seed=st.integers(0, 2**32 - 1),
    rank=st.integers(1, 8),
)
@settings(deadline=None, max_examples=60)
def test_triangularise_keeps_the_product(n, extra, seed, rank):
    rng = np.random.default_rng(seed)
    tall = rng.normal(size=(n + extra, min(rank, n))) @ rng.normal(size=(min(rank, n), n))
    found = tall.copy()
    triangularise(found)
    R = np.triu(found[:n])
    np.testing.assert_allclose(R.T @ R, tall.T @ tall, rtol=1e-10, atol=1e-10)
    assert (np.diag(R) >= 0).all()
    if rank >= n:
        assert (np.diag(R) > 0).all()


def test_triangularise_leaves_a_column_of_zeros_alone():
    tall = np.array([[3.0, 0.0, 1.0], [4.0, 0.0, 2.0], [0.0, 0.0, 2.0]])
    found = tall.copy()
    triangularise(found)
    R = np.triu(found)
    np.testing.assert_allclose(R.T @ R, tall.T @ tall, atol=1e-14)


@pytest.mark.parametrize("method", ALL)
def test_the_start_is_the_initial_sd(method):
    sd = np.array([10.0, 0.3, 2.0])
    root = np.ascontiguousarray(SEQUENTIAL[method].root(sd))
    np.testing.assert_allclose(covariance_of(method, root), np.diag(sd**2), rtol=1e-14)


@pytest.mark.parametrize("method", ["ekf", "sqrf", "ukf"])
def test_single_precision_rounds_the_double_result(method):
    problem = make_problem(5, 12, seed=2, spread=0.5)
    double, single = (update(method, problem, p) for p in ("double", "single"))
    for a, b in zip(double, single, strict=True):
        np.testing.assert_allclose(a, b, rtol=2e-4, atol=2e-4)
        assert not np.array_equal(a, b)
    for k in (0, 2, 3, 4):  # all but the covariance, which is derived
        assert np.array_equal(single[k], single[k].astype(np.float32))
