import numpy as np
import pytest
from conftest import simulation, st16_config, st16_matcher
from scipy.optimize import least_squares

from stcal.estimators.batch import covariance_from, levenberg_marquardt, observability
from stcal.estimators.information import reduce_rows
from stcal.execution import scheduler, serial
from stcal.matching import match
from stcal.pipeline.fitting import solve
from stcal.residuals import ARCLENGTH, select_stars

SIGMA = np.array([8e-6, 30.0, 30.0, 1e8, 1e3, 0.01, 0.01, 2e-4])


@pytest.fixture(scope="module")
def problem():
    data = simulation(2, 23, 120)
    frames = data.calibration.frames
    bounds = []
    for a in range(0, frames.n_frames, 30):
        part = frames.take(np.arange(a, min(a + 30, frames.n_frames)))
        matched = match(part, data.true.camera, np.eye(3), st16_matcher())
        selection = select_stars(matched, st16_config().noise, 4)
        bounds.append(ARCLENGTH.bind(selection, data.true.camera))
    return data, bounds


def test_agrees_with_scipys_least_squares(problem):
    data, bounds = problem
    start = data.initial.camera

    def residuals(z):
        camera = start.with_parameters(start.parameters + z * SIGMA)
        return np.concatenate([b.linearise(camera)[:, -1] for b in bounds])

    peer = least_squares(residuals, np.zeros(8), method="lm", xtol=1e-14, ftol=1e-14)
    ours = solve(bounds, start, SIGMA, np.arange(8), serial)
    assert ours.converged
    assert ours.chi2 == pytest.approx(2 * peer.cost, rel=1e-9)
    sd = np.sqrt(np.diag(covariance_from(ours.information)))
    step = (ours.parameters - start.parameters) / SIGMA - peer.x
    assert np.abs(step / sd).max() < 1e-3
    np.testing.assert_allclose(
        covariance_from(ours.information), np.linalg.inv(peer.jac.T @ peer.jac), rtol=2e-3
    )


def test_the_answer_does_not_depend_on_the_workers(problem):
    data, bounds = problem
    with scheduler(3) as threads:
        parallel = solve(bounds, data.initial.camera, SIGMA, np.arange(8), threads)
    alone = solve(bounds, data.initial.camera, SIGMA, np.arange(8), serial)
    assert np.array_equal(parallel.parameters, alone.parameters)
    assert np.array_equal(parallel.information.factor, alone.information.factor)


def test_a_hard_function_converges():
    """Rosenbrock's valley as a sum of squares, far from the solution."""

    def linearise(x):
        H = np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])
        r = np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])
        return reduce_rows(np.column_stack([H, r]), 2)

    solution = levenberg_marquardt(linearise, np.array([-1.2, 1.0]), np.ones(2))
    assert solution.converged
    np.testing.assert_allclose(solution.parameters, [1, 1], atol=1e-5)


def test_a_linear_problem_is_looked_at_twice():
    """At the start and after the step; that nothing is left to do needs no third pass."""
    rng = np.random.default_rng(4)
    H, y, looks = rng.normal(size=(50, 3)), rng.normal(size=50), []

    def linearise(x):
        looks.append(x)
        return reduce_rows(np.column_stack([H, H @ x - y]), 50)

    solution = levenberg_marquardt(linearise, np.full(3, 10.0), np.ones(3))
    expected, cost = np.linalg.lstsq(H, y)[:2]
    assert len(looks) == 2
    assert solution.converged
    np.testing.assert_allclose(solution.parameters, expected, rtol=1e-9)
    assert solution.chi2 == pytest.approx(cost[0], rel=1e-9)
    assert np.abs(solution.information.projected).max() < 1e-9


def test_nan_residuals_do_not_count_as_convergence():
    def linearise(x):
        return reduce_rows(np.array([[1.0, np.nan]]), 1)

    solution = levenberg_marquardt(linearise, np.zeros(1), np.ones(1))
    assert not solution.converged
    assert solution.iterations == 0


def test_observability_finds_the_weak_direction():
    rng = np.random.default_rng(6)
    a, b = rng.normal(size=(2, 500))
    rows = np.column_stack([a, a + 1e-3 * b, b, np.zeros(500)])
    seen = observability(reduce_rows(rows, 500), np.array([1.0, 1.0, 1e-6]))
    weak = seen.singular_vectors[:, -1]
    assert abs(weak[0]) == pytest.approx(np.sqrt(0.5), abs=1e-3)
    assert weak[0] == pytest.approx(-weak[1], abs=2e-3)
    assert seen.condition_scaled > 1e3
    assert seen.condition_raw > 1e8 or seen.condition_raw != seen.condition_scaled
    np.testing.assert_allclose(seen.singular_values, np.linalg.svd(rows[:, :3])[1], rtol=1e-9)
