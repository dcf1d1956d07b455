"""A filter that goes astray is caught, falls back to the baseline, and says so."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from conftest import simulation, st16_config, st16_matcher

from stcal.matching import Matcher, match
from stcal.pipeline.filter_run import EVENTS, filter_fragment
from stcal.pipeline.filtering import Variant, make_filter
from stcal.pipeline.sequential import fit_sequential

WINDOW = st16_config().sequential.window_frames
ASTRAY = [EVENTS.index(name) for name in ("fewer frames fixed", "fewer stars matched")]
INNOVATIONS = EVENTS.index("innovations too large")
FRAMES, JUMP = 300, 150


@cache
def jumping(number):
    """A sensor whose camera is off by Table III in the first half, and then as it was calibrated.

    The calibration on board is the true camera: sequential estimates from an undistorted one (the
    simulated laboratory's) are degenerate.
    """
    data = simulation(number, 51, FRAMES)
    frames, camera = data.calibration.frames, data.true.camera
    off = camera.with_parameters(2.0 * camera.parameters - data.initial.camera.parameters)
    row, col = off.project(camera.directions(frames.row_px, frames.col_px))
    early = (frames.exposure_of_star < 2 * JUMP) & np.isfinite(row)
    moved = replace(
        frames,
        row_px=np.where(early, row, frames.row_px),
        col_px=np.where(early, col, frames.col_px),
    )
    return replace(data, initial=data.true), moved


def through(data, frames, variant, matcher=None, baseline=None):
    matcher = matcher or st16_matcher()
    if baseline is None:
        baseline = match(frames, data.initial.camera, data.initial.c_sd, matcher)
    chosen = make_filter(variant, data.initial, matcher)
    state, history, _ = filter_fragment(chosen, baseline, chosen.start)
    return chosen, state, history


def quiet_matcher():
    """Who believes in a centroid noise of a twentieth of the true one."""
    noise = st16_config().noise.model_copy(update={"sd_px": 0.02})
    return Matcher(st16_matcher().catalogue, st16_config().model_copy(update={"noise": noise}))


@pytest.mark.parametrize("number", [1, 2, 3, 4, 5, 6])
def test_no_false_alarm_on_healthy_sensors(number):
    for seed in range(51, 56):
        data = simulation(number, seed, 150)
        for method in ("sqrf", "ukf"):
            _, _, history = through(data, data.calibration.frames, Variant(method=method))
            assert not history.event.any(), (seed, method)
            assert not history.on_baseline.any()


def test_one_noisy_first_frame_is_no_alarm():
    """Before the noise is known, one frame says nothing of its innovations' size."""
    data = simulation(6, 121, 150)
    _, _, history = through(data, data.calibration.frames, Variant())
    assert history.nis[0] / history.arcs[0] > st16_config().sequential.divergence
    assert not history.event.any()


@pytest.mark.parametrize("number", [1, 2, 4])
@pytest.mark.parametrize("method", ["sqrf", "ukf"])
def test_a_camera_that_jumps_makes_the_filter_start_anew(number, method):
    data, frames = jumping(number)
    chosen, _, history = through(data, frames, Variant(method=method))
    events = np.flatnonzero(history.event)
    assert len(events) == 1
    (event,) = events
    assert JUMP < event < JUMP + WINDOW
    assert history.event[event] in ASTRAY
    # Back to the baseline exactly, with the uncertainty of the start.
    assert np.array_equal(history.x[event], np.zeros(8))
    scale = history.noise_scale[event]
    expected = np.sqrt(np.diag(chosen.covariance(chosen.start))) * scale
    np.testing.assert_allclose(history.sd[event], expected, rtol=1e-12)
    # The baseline is in use for a window, and then no longer.
    expected = np.zeros(FRAMES, bool)
    expected[event : event + WINDOW] = True
    assert np.array_equal(history.on_baseline, expected)
    # The camera is found as it is now: as it was calibrated.
    assert np.abs(history.x[-1] / history.sd[-1]).max() < 4.5


def test_without_the_shadow_nobody_minds_lost_frames():
    """As the user asked; the innovations are still watched."""
    data, frames = jumping(6)
    _, _, history = through(data, frames, Variant(shadow=False))
    assert not np.isin(history.event, ASTRAY).any()
    assert history.fixed[JUMP + 10 :].mean() < history.fixed_baseline[JUMP + 10 :].mean()


@pytest.mark.parametrize("shadow", [True, False])
def test_innovations_beyond_all_belief_are_caught(shadow):
    """A noise configured far too small: with and without the shadow, again and again."""
    data = simulation(2, 51, FRAMES)
    matcher = quiet_matcher()
    _, _, history = through(data, data.calibration.frames, Variant(shadow=shadow), matcher)
    assert (history.event == INNOVATIONS).sum() > 5
    assert np.array_equal(history.x[history.event > 0], np.zeros(((history.event > 0).sum(), 8)))


def test_process_noise_that_loses_the_matches_is_caught():
    data = simulation(4, 51, FRAMES)
    names = data.initial.camera.parameter_names
    enormous = Variant(process_noise=dict.fromkeys(names, 1e4))
    _, _, history = through(data, data.calibration.frames, enormous)
    events = np.flatnonzero(history.event)
    assert len(events) > 3
    assert np.isin(history.event[events], ASTRAY).all()
    used = np.where(history.on_baseline, history.fixed_baseline, history.fixed)
    assert used.mean() > history.fixed.mean()


def test_a_fallback_is_not_followed_by_another_before_anything_is_known():
    """The window was emptied: a frame or two with fewer stars say nothing."""
    data = simulation(4, 51, FRAMES)
    names = data.initial.camera.parameter_names
    enormous = Variant(process_noise=dict.fromkeys(names, 1e4))
    _, _, history = through(data, data.calibration.frames, enormous)
    stars = np.flatnonzero(history.event == EVENTS.index("fewer stars matched"))
    events = np.flatnonzero(history.event)
    for event in stars:
        before = events[events < event]
        assert not len(before) or event - before[-1] >= WINDOW
    # Three lost frames need three frames.
    assert np.diff(events).min() >= st16_config().sequential.lost_frames


def falsified(data, share, seed=1):
    """The baseline's matches with a share of the stars moved by some milliradians."""
    frames = data.calibration.frames
    baseline = match(frames, data.initial.camera, data.initial.c_sd, st16_matcher())
    rng = np.random.default_rng(seed)
    hit = (baseline.star >= 0) & (rng.random(len(baseline.star)) < share)
    s_i = baseline.s_i.copy()
    s_i[hit] += rng.normal(0.0, 3e-3, (hit.sum(), 3))
    s_i[hit] /= np.linalg.norm(s_i[hit], axis=1)[:, None]
    return baseline, replace(baseline, s_i=s_i), hit


def test_false_matches_are_screened_and_do_not_bend_the_estimate():
    """From elsewhere, without rematching: one star in twenty."""
    data = simulation(4, 51, FRAMES)
    variant = Variant(rematch=False)
    right, wrong, hit = falsified(data, 0.05)
    _, _, clean = through(data, None, variant, baseline=right)
    _, _, history = through(data, None, variant, baseline=wrong)
    assert not history.event.any()
    assert history.rejected.sum() > 0.8 * hit.sum()
    assert np.abs((history.x[-1] - clean.x[-1]) / clean.sd[-1]).max() < 2.0


def test_matches_that_are_mostly_false_never_pass_as_a_good_fit():
    data = simulation(4, 51, FRAMES)
    _, wrong, _ = falsified(data, 0.8)
    _, _, history = through(data, None, Variant(rematch=False), baseline=wrong)
    used = history.arcs > 0
    far = np.sqrt(history.nis[used].sum() / history.arcs[used].sum())
    assert history.event.any() or far > st16_config().fit.maximum_noise_scale


@pytest.fixture(scope="module")
def refused():
    data = simulation(2, 51, FRAMES)
    return fit_sequential(
        [data.calibration.frames], data.initial, quiet_matcher(), {"parent_sha256": ""}, Variant()
    )


def test_a_filter_that_keeps_falling_back_is_refused_with_its_frames(refused):
    assert refused.calibration is None
    reasons = " ".join(refused.document["verdict"]["reasons"])
    assert "fell back to the baseline" in reasons
    events = np.flatnonzero(refused.history.event)
    assert f"{EVENTS[refused.history.event[events[0]]]} at frame" in reasons
    assert f"frame {refused.history.frame_id[events[0]]}" in reasons


def test_the_document_lists_every_event(refused):
    history, described = refused.history, refused.document["sequential"]
    events = np.flatnonzero(history.event)
    assert [e["frame_id"] for e in described["events"]] == history.frame_id[events].tolist()
    assert [e["event"] for e in described["events"]] == [EVENTS[k] for k in history.event[events]]
    assert all(e["time_utc"].endswith("Z") for e in described["events"])
    availability = described["availability"]
    used = np.where(history.on_baseline, history.fixed_baseline, history.fixed)
    assert availability["used"] == pytest.approx(used.mean())
    assert availability["estimate"] == pytest.approx(history.fixed.mean())
    assert availability["baseline"] == pytest.approx(history.fixed_baseline.mean())
    assert described["on_baseline"] == bool(history.on_baseline[-1])


def test_one_fallback_that_was_lived_down_is_no_refusal():
    data, frames = jumping(1)
    result = fit_sequential(
        [frames], data.initial, st16_matcher(), {"parent_sha256": ""}, Variant()
    )
    assert len(result.document["sequential"]["events"]) == 1
    assert "fell back" not in " ".join(result.document["verdict"]["reasons"])


def test_a_fallback_near_the_end_is_a_refusal():
    """The new estimate has not stood a window yet."""
    data, frames = jumping(2)
    short = frames.take(np.arange(JUMP + 15))
    result = fit_sequential([short], data.initial, st16_matcher(), {"parent_sha256": ""}, Variant())
    assert result.history.on_baseline[-1]
    assert result.calibration is None
    assert "had not proven itself" in " ".join(result.document["verdict"]["reasons"])
