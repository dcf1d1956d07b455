from dataclasses import replace

import numpy as np
import pytest
from conftest import simulation, st16_config, st16_matcher

from stcal.config import Noise
from stcal.matching import match
from stcal.residuals.selection import (
    centroid_sd,
    reject_outliers,
    robust_scale,
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


def test_departures_have_unit_sd_under_the_true_noise(data):
    part = data.calibration
    selection = select_stars(matched(data, part.frames), st16_config().noise, 4)
    selection = selection.keep(~part.truth.outlier[selection.star], 4)
    selection = replace(selection, sd_px=part.truth.sd_px[selection.star])
    departure = star_departures(selection, data.true.camera)
    assert np.sqrt((departure**2).mean() / 2) == pytest.approx(1.0, abs=0.05)
    assert robust_scale(departure) == pytest.approx(1.0, abs=0.06)


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


def test_noise_models():
    intensity = np.array([100.0, 1000.0, 4000.0, np.nan, 0.0])
    constant = Noise(sd_px=0.2)
    assert centroid_sd(constant, intensity).tolist() == [0.2] * 5
    model = Noise(model="intensity", sd_px=0.3, photon_sd_px=0.4, reference_intensity=1000.0)
    faint = np.hypot(0.3, 4.0)
    expected = [np.hypot(0.3, 0.4 * np.sqrt(10.0)), 0.5, np.hypot(0.3, 0.2), 0.5, faint]
    np.testing.assert_allclose(centroid_sd(model, intensity), expected)
