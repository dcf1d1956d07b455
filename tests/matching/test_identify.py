from dataclasses import replace

import numpy as np
import pytest
from conftest import simulation, st16_config, st16_matcher
from scipy.spatial.transform import Rotation

from stcal.matching import METHODS, REASONS, Matcher, match
from stcal.matching.identify import rematch_given, telemetered_matches
from stcal.matching.kernels import brightest_first
from stcal.matching.verify_kernels import best_rotation


def wrong_matches(part, matched):
    """(matches, false ones) against the simulator's truth."""
    codes = st16_matcher().catalogue.star_id
    found = matched.is_matched
    return int(found.sum()), int((codes[matched.star[found]] != part.truth.star_id[found]).sum())


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("number", [2, 6])
def test_a_calibrated_camera_is_identified_without_false_matches(number, method):
    data = simulation(number, 31, 150)
    part = data.calibration
    matched = match(part.frames, data.true.camera, data.true.c_sd, st16_matcher(), method)
    matches, false = wrong_matches(part, matched)
    assert matches > 1500
    assert false <= matches / 2000
    truth = Rotation.from_quat(part.truth.q_si).as_matrix().swapaxes(1, 2)
    off = Rotation.from_matrix(
        matched.c_di[matched.solved] @ (data.true.c_sd.T @ truth[matched.solved]).swapaxes(1, 2)
    ).magnitude()
    assert off.max() < 3e-3


def true_attitudes(data, part):
    c_si = Rotation.from_quat(part.truth.q_si).as_matrix().swapaxes(1, 2)
    return data.true.c_sd.T @ c_si


def test_both_methods_agree_with_a_calibrated_camera():
    """Hints from the truth, so that sparse exposures have one too."""
    agree = total = 0
    for number in (1, 2, 3, 4, 5, 6):
        data = simulation(number, 32, 150)
        part = data.calibration
        frames, hints = part.frames, true_attitudes(data, part)
        lost, guided = (
            match(frames, data.true.camera, data.true.c_sd, st16_matcher(), m, hints)
            for m in METHODS
        )
        same = np.bincount(
            frames.exposure_of_star, lost.star != guided.star, minlength=frames.n_exposures
        )
        agree += int(((same == 0) & (lost.solved == guided.solved)).sum())
        total += frames.n_exposures
    assert total >= 1800
    assert total - agree <= 0.001 * total


@pytest.mark.parametrize("number", [2, 3, 4])
def test_few_false_matches_with_the_offsets_of_table_iii(number):
    data = simulation(number, 33, 150)
    part = data.calibration
    matched = match(part.frames, data.initial.camera, data.initial.c_sd, st16_matcher())
    matches, false = wrong_matches(part, matched)
    assert matches > 300
    assert false <= matches / 200 + 1


def test_random_detections_are_not_identified():
    data = simulation(4, 34, 150)
    frames = data.calibration.frames
    rng = np.random.default_rng(1)
    noise = replace(
        frames,
        row_px=rng.uniform(0, 1943, frames.n_stars),
        col_px=rng.uniform(0, 2591, frames.n_stars),
        q_si=np.full_like(frames.q_si, np.nan),
    )
    matched = match(noise, data.true.camera, np.eye(3), st16_matcher())
    assert matched.solved.sum() <= 1
    assert set(np.unique(matched.reason)) <= {0, 1, 2}
    assert REASONS[2] == "no match"


def test_guided_finds_the_attitude_from_a_displaced_hint():
    data = simulation(3, 35, 100)
    frames = data.calibration.frames
    lost = match(frames, data.true.camera, np.eye(3), st16_matcher())
    rng = np.random.default_rng(2)
    turn = Rotation.from_rotvec(rng.normal(0, np.radians(0.08), (frames.n_exposures, 3)))
    hints = turn.as_matrix() @ lost.c_di
    # Without lost in space behind it, so that the hint itself must do.
    guided = match(frames, data.true.camera, np.eye(3), st16_matcher(), "guided", hints)
    assert (guided.star == lost.star).mean() > 0.999


def test_frames_are_independent_of_their_neighbours():
    data = simulation(4, 36, 60)
    frames = data.calibration.frames
    whole = match(frames, data.initial.camera, np.eye(3), st16_matcher())
    parts = [
        match(frames.take(np.arange(a, a + 20)), data.initial.camera, np.eye(3), st16_matcher())
        for a in (0, 20, 40)
    ]
    assert np.array_equal(whole.star, np.concatenate([p.star for p in parts]))
    assert np.array_equal(whole.c_di, np.concatenate([p.c_di for p in parts]), equal_nan=True)


@pytest.mark.parametrize("method", METHODS)
def test_a_centroid_that_is_not_a_number_costs_only_its_own_match(method):
    data = simulation(4, 36, 60)
    frames, hints = data.calibration.frames, true_attitudes(data, data.calibration)
    spoilt = frames.star_offsets[:-1][frames.stars_per_exposure > 8]
    row_px = frames.row_px.copy()
    row_px[spoilt] = np.nan
    broken = replace(frames, row_px=row_px)
    whole, found = (
        match(f, data.true.camera, data.true.c_sd, st16_matcher(), method, hints)
        for f in (frames, broken)
    )
    good = np.setdiff1d(np.arange(frames.n_stars), spoilt)
    assert (found.star[spoilt] == -1).all()
    assert (found.star[good] == whole.star[good]).mean() > 0.99
    nothing = replace(frames, row_px=np.full(frames.n_stars, np.nan))
    assert not match(
        nothing, data.true.camera, data.true.c_sd, st16_matcher(), method, hints
    ).solved.any()


def test_matched_stars_are_unique_and_within_tolerance():
    data = simulation(1, 37, 100)
    frames = data.calibration.frames
    matched = match(frames, data.initial.camera, np.eye(3), st16_matcher())
    found = matched.is_matched
    key = frames.exposure_of_star[found] * 100_000 + matched.star[found]
    assert len(np.unique(key)) == found.sum()
    limit = st16_config().matching.star_tolerance_urad * 1e-6
    assert np.nanmax(matched.residual) <= limit * (1 + 1e-6)
    counts = matched.matches_per_exposure
    assert (counts[matched.solved] >= st16_config().matching.minimum_matches).all()
    assert (counts[~matched.solved] == 0).all()


def test_a_stricter_rule_refuses_more():
    data = simulation(4, 38, 80)
    strict = st16_config().model_copy(
        update={"matching": st16_config().matching.model_copy(update={"minimum_matches": 8})}
    )
    catalogue = st16_matcher().catalogue
    loose = match(data.calibration.frames, data.true.camera, np.eye(3), st16_matcher())
    tight = match(data.calibration.frames, data.true.camera, np.eye(3), Matcher(catalogue, strict))
    assert tight.solved.sum() < loose.solved.sum()
    assert (tight.matches_per_exposure[tight.solved] >= 8).all()


def test_empty_and_three_star_frames_are_told_apart():
    data = simulation(4, 39, 40)
    frames = data.calibration.frames
    counts = frames.stars_per_exposure
    keep = np.arange(frames.n_stars) - frames.star_offsets[frames.exposure_of_star] < 3
    few = replace(
        frames,
        star_offsets=np.concatenate(([0], np.cumsum(np.minimum(counts, 3)))),
        **{k: getattr(frames, k)[keep] for k in ("row_px", "col_px", "intensity", "star_id")},
    )
    matched = match(few, data.true.camera, np.eye(3), st16_matcher())
    assert not matched.solved.any()
    assert (matched.reason == 1).all()
    none = frames.take(np.arange(0))
    assert match(none, data.true.camera, np.eye(3), st16_matcher()).star.shape == (0,)


def test_telemetered_matches_and_their_attitudes():
    data = simulation(5, 40, 60)
    frames, catalogue = data.calibration.frames, st16_matcher().catalogue
    star = telemetered_matches(frames, data.initial.camera, st16_matcher())
    named = frames.star_id != 0
    assert (catalogue.star_id[star[star >= 0]] == frames.star_id[star >= 0]).all()
    assert (star[~named] == -1).all()
    assert (star[named] >= 0).all()
    solved = rematch_given(frames, data.initial.camera, catalogue, star)
    again = match(frames, data.initial.camera, np.eye(3), st16_matcher())
    both = solved.solved & again.solved
    np.testing.assert_allclose(solved.c_di[both], again.c_di[both], atol=1e-9)


def test_brightness_order_ranks_known_intensities_first():
    rng = np.random.default_rng(1)
    for count in (0, 1, 2, 40):
        intensity = rng.integers(0, 12, count).astype(float)
        intensity[::7] = np.nan
        order = np.empty(count, np.int64)
        brightest_first(intensity, order)
        key = np.where(np.isnan(intensity), np.inf, -intensity)
        assert order.tolist() == np.argsort(key, kind="stable").tolist()
        few = np.empty(min(count, 12), np.int64)
        brightest_first(intensity, few)
        assert few.tolist() == order[:12].tolist()


def test_the_matrix_of_products_gives_the_wahba_solution_from_degrees_away():
    rng = np.random.default_rng(3)
    u = np.array([0.0, 0.0, 1.0]) + rng.normal(0.0, 0.1, (6, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    truth = Rotation.random(rng=rng)
    s = truth.apply(u) + rng.normal(0.0, 3e-4, (6, 3))
    s /= np.linalg.norm(s, axis=1, keepdims=True)
    best, _ = Rotation.align_vectors(s, u)
    c = (Rotation.from_rotvec([0.03, -0.02, 0.04]) * truth).as_matrix()
    assert best_rotation(tuple((s.T @ u).ravel()), c)
    np.testing.assert_allclose(c, best.as_matrix(), atol=1e-13)
    same = np.repeat(u[:1], 3, axis=0)
    assert not best_rotation(tuple((same.T @ same).ravel()), np.eye(3))


def test_telemetered_matches_are_checked_for_consistency():
    data = simulation(5, 40, 120)
    frames, catalogue = data.calibration.frames, st16_matcher().catalogue
    rng = np.random.default_rng(5)
    known = np.flatnonzero(frames.star_id != 0)
    wrong = rng.choice(known, len(known) // 10, replace=False)
    ids = frames.star_id.copy()
    ids[wrong] = rng.choice(catalogue.star_id, len(wrong))
    false_exposures = rng.choice(frames.n_exposures, 12, replace=False)
    inside = np.isin(frames.exposure_of_star, false_exposures) & (ids != 0)
    ids[inside] = rng.choice(catalogue.star_id, int(inside.sum()))
    spoilt = replace(frames, star_id=ids)
    star = telemetered_matches(spoilt, data.initial.camera, st16_matcher())
    kept = star >= 0
    assert (catalogue.star_id[star[kept]] == frames.star_id[kept]).mean() > 0.998
    good = np.setdiff1d(known, np.append(wrong, np.flatnonzero(inside)))
    assert kept[good].mean() > 0.97


def test_a_repeated_identifier_counts_for_nothing():
    data = simulation(5, 40, 60)
    frames = data.calibration.frames
    first = int(np.flatnonzero(frames.star_id != 0)[0])
    other = first + 1
    ids = frames.star_id.copy()
    assert frames.exposure_of_star[other] == frames.exposure_of_star[first]
    ids[other] = ids[first]
    star = telemetered_matches(replace(frames, star_id=ids), data.initial.camera, st16_matcher())
    assert star[first] == star[other] == -1


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("number", [1, 4])
def test_the_kernels_attitude_is_the_wahba_solution(number, method):
    """With an uncalibrated camera, so that hypotheses are tried and given up."""
    data = simulation(number, 42, 60)
    frames, hints = data.calibration.frames, true_attitudes(data, data.calibration)
    matched = match(frames, data.initial.camera, np.eye(3), st16_matcher(), method, hints)
    again = rematch_given(frames, data.initial.camera, st16_matcher().catalogue, matched.star)
    assert np.array_equal(matched.solved, again.solved)
    np.testing.assert_allclose(matched.c_di, again.c_di, atol=1e-12)
    np.testing.assert_allclose(matched.s_i, again.s_i, atol=1e-15)
    np.testing.assert_allclose(matched.residual, again.residual, atol=1e-12)
