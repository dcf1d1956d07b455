from dataclasses import replace

import numpy as np
import pytest
from conftest import simulation, st16_config, st16_matcher

from stcal.config import Noise
from stcal.geometry.rotations import nearest_rotation
from stcal.matching import match
from stcal.residuals.departures import count_departures, robust_scale
from stcal.residuals.selection import (
    centroid_sd,
    reject_outliers,
    select_stars,
    star_departures,
)


@pytest.fixture(scope="module")
def data():
    return simulation(4, 22, 80)


def matched(data, frames):
    return match(frames, data.true.camera, np.eye(3), st16_matcher())


def test_only_exposures_with_enough_stars_are_used(data):
    selection = select_stars(matched(data, data.calibration.frames), st16_config().noise, 7)
    assert np.diff(selection.offsets).min() >= 7
    assert (np.diff(selection.exposure) >= 0).all()


@pytest.mark.parametrize("minimum", [0, 4, 7])
def test_stars_of_rich_exposures_are_kept_and_numbered_anew(data, minimum):
    found = matched(data, data.calibration.frames)
    selection = select_stars(found, st16_config().noise, minimum)
    counts = found.matches_per_exposure * found.solved
    used = np.flatnonzero((counts >= minimum) & (counts > 0))
    assert (counts == minimum).any() or minimum == 0
    assert np.array_equal(np.diff(selection.offsets), counts[used])
    assert np.array_equal(found.frames.exposure_of_star[selection.star], used[selection.exposure])
    half = np.arange(len(selection.star)) % 2 == 0
    kept = selection.keep(half, 3)
    left = np.bincount(selection.exposure[half], minlength=selection.n_exposures)
    assert np.array_equal(np.diff(kept.offsets), left[left >= 3])


def test_departures_have_unit_sd_under_the_true_noise(data):
    part = data.calibration
    selection = select_stars(matched(data, part.frames), st16_config().noise, 4)
    selection = selection.keep(~part.truth.outlier[selection.star], 4)
    selection = replace(selection, sd_px=part.truth.sd_px[selection.star])
    departure = star_departures(selection, data.true.camera)
    assert np.sqrt((departure**2).mean() / 2) == pytest.approx(1.0, abs=0.05)
    assert robust_scale(count_departures(departure)) == pytest.approx(1.0, abs=0.06)


def test_gross_centroids_are_rejected_and_others_kept(data):
    part = data.calibration
    found = matched(data, part.frames)
    row = part.frames.row_px.copy()
    clean = np.flatnonzero(found.is_matched & ~part.truth.outlier)
    moved = np.random.default_rng(1).choice(clean, 25, replace=False)
    row[moved] += 6.0
    spoilt = replace(found, frames=replace(part.frames, row_px=row))
    selection = select_stars(spoilt, st16_config().noise, 4)
    kept = reject_outliers(selection, data.true.camera, 5.0, 1.0, 4)
    # In an exposure of five stars two may explain it equally well.
    assert np.isin(kept.star, moved).sum() <= 1
    lost = np.setdiff1d(np.intersect1d(clean, selection.star), np.append(kept.star, moved))
    assert len(lost) < 0.03 * len(selection.star)


def departures_by_svd(selection, camera):
    """Studentised departures, exposure by exposure, straight from the formulas."""
    s_d = camera.directions(selection.row_px, selection.col_px)
    sd = selection.sd_px * camera.noise_scale(selection.row_px, selection.col_px)
    out = np.empty(len(sd))
    for a, b in zip(selection.offsets[:-1], selection.offsets[1:], strict=True):
        s, w = s_d[a:b], sd[a:b] ** -2.0
        c = nearest_rotation((s.T * w) @ selection.s_i[a:b])
        p = np.linalg.inv(np.eye(3) * w.sum() - (s.T * w) @ s)
        followed = np.trace(p) - np.einsum("ki,ij,kj->k", s, p, s)
        angle = np.linalg.norm(s - selection.s_i[a:b] @ c.T, axis=1)
        out[a:b] = angle / sd[a:b] / np.sqrt(np.maximum(1.0 - 0.5 * followed * w, 0.1))
    return out


def spoilt(data, count):
    """A selection with ``count`` centroids off, and five stars in every fourth exposure."""
    selection = select_stars(matched(data, data.calibration.frames), st16_config().noise, 4)
    place = np.arange(len(selection.star)) - selection.offsets[selection.exposure]
    selection = selection.keep((selection.exposure % 4 > 0) | (place < 5), 4)
    row = selection.row_px.copy()
    moved = np.random.default_rng(2).choice(len(row), count, replace=False)
    row[moved] += 8.0
    return replace(selection, row_px=row)


def test_departures_are_those_by_svd(data):
    selection, camera = spoilt(data, 20), data.initial.camera
    expected = departures_by_svd(selection, camera)
    np.testing.assert_allclose(star_departures(selection, camera), expected, rtol=1e-7)


def test_the_worst_star_of_each_exposure_goes_first(data):
    """Round by round over all exposures, as one would by hand."""
    selection, camera = spoilt(data, 60), data.true.camera
    found = reject_outliers(selection, camera, 4.0, 1.1, 4)
    for _ in range(30):
        departure = departures_by_svd(selection, camera)
        worst = np.maximum.reduceat(departure, selection.offsets[:-1])[selection.exposure]
        out = (departure > 4.0 * 1.1) & (departure == worst)
        if not out.any():
            break
        selection = selection.keep(~out, 4)
    assert np.array_equal(found.star, selection.star)
    assert np.array_equal(found.exposure, selection.exposure)
    assert found.n_exposures == selection.n_exposures


def test_nothing_is_left_out_of_nothing(data):
    selection = select_stars(matched(data, data.calibration.frames), st16_config().noise, 99)
    assert selection.n_exposures == 0
    assert len(star_departures(selection, data.true.camera)) == 0
    assert reject_outliers(selection, data.true.camera, 5.0, 1.0, 4) is selection


def test_noise_models():
    intensity = np.array([100.0, 1000.0, 4000.0, np.nan, 0.0])
    constant = Noise(sd_px=0.2)
    assert centroid_sd(constant, intensity).tolist() == [0.2] * 5
    model = Noise(model="intensity", sd_px=0.3, photon_sd_px=0.4, reference_intensity=1000.0)
    faint = np.hypot(0.3, 4.0)
    expected = [np.hypot(0.3, 0.4 * np.sqrt(10.0)), 0.5, np.hypot(0.3, 0.2), 0.5, faint]
    np.testing.assert_allclose(centroid_sd(model, intensity), expected)
