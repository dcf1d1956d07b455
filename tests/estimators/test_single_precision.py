"""Where the plain Kalman filter breaks in single precision, and the square-root filter does not."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import simulation, st16_config, st16_matcher

from stcal.estimators.sequential import SEQUENTIAL
from stcal.matching import Matcher, match
from stcal.pipeline.filter_run import EVENTS, filter_fragment
from stcal.pipeline.filtering import Variant, make_filter
from stcal.pipeline.sequential import fit_sequential

NUMERICAL = EVENTS.index("numerical")


def two_nearly_equal_measurements(method, precision, delta):
    """State, sd and least eigenvalue after rows [1 1 1] and [1 1 1 + delta] over delta, P = 1.

    The classic trial of a filter's arithmetic (Bierman 1977, Grewal & Andrews 2001): delta itself
    is well within the precision, its square isn't.
    """
    rows = np.array([[1.0, 1.0, 1.0, 0.7 * delta], [1.0, 1.0, 1.0 + delta, -0.4 * delta]]) / delta
    chosen = SEQUENTIAL[method]
    x, root = np.zeros(3), np.ascontiguousarray(chosen.root(np.ones(3)))
    innovation, score = np.zeros(2), np.zeros(2)
    chosen.steps[precision].update(rows, np.zeros((2, 7)), x, root, innovation, score)
    covariance = np.empty((3, 3))
    chosen.covariance(root, covariance)
    return x, np.sqrt(np.abs(np.diag(covariance))), np.linalg.eigvalsh(covariance)[0], score


@pytest.mark.parametrize("delta", [1e-2, 1e-3, 1e-4, 3e-5])
def test_the_square_root_filter_holds_what_single_precision_can_hold(delta):
    x, sd, least, score = two_nearly_equal_measurements("sqrf", "single", delta)
    expected = two_nearly_equal_measurements("smoother", "double", delta)
    assert np.abs((x - expected[0]) / expected[1]).max() < 1e-3
    np.testing.assert_allclose(sd, expected[1], rtol=1e-3)
    np.testing.assert_allclose(score, expected[3], rtol=1e-2)
    assert least > 0.9 * expected[2]


def test_the_plain_filter_loses_accuracy_and_then_definiteness():
    """At delta^2 = 1e-7 a quarter of an sd; at 1e-8 the covariance is indefinite, and says so."""
    x, *_ = two_nearly_equal_measurements("ekf", "single", 3e-4)
    expected = two_nearly_equal_measurements("smoother", "double", 3e-4)
    assert np.abs((x - expected[0]) / expected[1]).max() > 0.1
    x, _, least, score = two_nearly_equal_measurements("ekf", "single", 1e-4)
    assert least < 0.0
    assert np.isnan(x).all()
    assert np.isnan(score).all()


def test_the_plain_filter_is_as_good_in_double_precision():
    x, sd, *_ = two_nearly_equal_measurements("ekf", "double", 1e-4)
    expected = two_nearly_equal_measurements("smoother", "double", 1e-4)
    assert np.abs((x - expected[0]) / expected[1]).max() < 1e-6
    np.testing.assert_allclose(sd, expected[1], rtol=1e-6)


def with_prior(sigma):
    section = st16_config().sequential.model_copy(update={"initial_sd_sigma": sigma})
    return Matcher(
        st16_matcher().catalogue, st16_config().model_copy(update={"sequential": section})
    )


def through_the_frames(method, precision, number, prior):
    data, matcher = simulation(number, 51, 300), with_prior(prior)
    frames = data.calibration.frames
    baseline = match(frames, data.initial.camera, data.initial.c_sd, matcher)
    chosen = make_filter(Variant(method=method, precision=precision), data.initial, matcher)
    state, history, _ = filter_fragment(chosen, baseline, chosen.start)
    return state.x, np.sqrt(np.diag(chosen.covariance(state))), history


@pytest.mark.parametrize("number", [2, 4, 5, 6])
@pytest.mark.parametrize("method", ["sqrf", "ukf"])
def test_single_precision_costs_the_square_root_filters_nothing(number, method):
    """A thousandth of an sd at the default prior, degenerate sensor 5 too (measured 2e-4)."""
    x, sd, history = through_the_frames(method, "double", number, 10.0)
    short_x, short_sd, short = through_the_frames(method, "single", number, 10.0)
    assert not history.event.any()
    assert not short.event.any()
    assert np.abs((short_x - x) / sd).max() < 2e-3
    np.testing.assert_allclose(short_sd, sd, rtol=2e-3)
    assert not np.array_equal(short_x, x)


@pytest.mark.parametrize("number", [1, 4, 6])
def test_the_plain_filter_breaks_in_single_precision_and_says_so(number):
    """From a prior of 30 sigma: within 20 frames, again and again; in double precision never."""
    x, sd, history = through_the_frames("ekf", "double", number, 30.0)
    assert not history.event.any()
    short_x, _, short = through_the_frames("ekf", "single", number, 30.0)
    events = np.flatnonzero(short.event == NUMERICAL)
    assert len(events) > 10
    assert events[0] < 30
    assert short.on_baseline[events].all()
    # Never a negative variance, or a number that isn't finite.
    assert (short.sd > 0).all()
    assert np.isfinite(short.x).all()
    assert np.abs((short_x - x) / sd).max() > 1.0
    root_x, _, root = through_the_frames("sqrf", "single", number, 30.0)
    assert not root.event.any()
    assert np.abs((root_x - x) / sd).max() < 0.01


def test_a_broken_plain_filter_is_refused_with_its_reason():
    data = simulation(4, 51, 300)
    result = fit_sequential(
        [data.calibration.frames], data.initial, with_prior(100.0), {"parent_sha256": "a" * 64},
        Variant(method="ekf", precision="single"),
    )  # fmt: skip
    assert result.calibration is None
    assert "numerical at frame" in " ".join(result.document["verdict"]["reasons"])
    described = result.document["sequential"]
    assert {e["event"] for e in described["events"]} >= {"numerical"}
    assert described["innovations"]["per_arc"] is not None


def test_a_state_that_is_no_number_starts_anew_from_the_baseline():
    """Whatever made it so."""
    data = simulation(4, 51, 300)
    matcher = st16_matcher()
    baseline = match(data.calibration.frames, data.initial.camera, data.initial.c_sd, matcher)
    chosen = make_filter(Variant(), data.initial, matcher)
    state, _, _ = filter_fragment(chosen, baseline.take(np.arange(60)), chosen.start)
    for broken in (
        replace(state, x=np.full(8, np.nan)),
        replace(state, root=np.full((8, 8), np.inf)),
        replace(state, root=np.zeros((8, 8))),
    ):
        after, history, _ = filter_fragment(chosen, baseline.take(np.arange(60, 61)), broken)
        assert history.event[0] == NUMERICAL
        assert np.array_equal(after.x, chosen.start.x)
        assert np.array_equal(after.root, chosen.start.root)
