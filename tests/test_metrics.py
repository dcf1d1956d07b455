import numpy as np
import pytest
from conftest import simulation, st16_config, st16_matcher

from stcal.matching import match
from stcal.metrics import (
    Blocks,
    bootstrap,
    difference,
    occupied_cells,
    pair_sums,
    ratio,
    residual_vectors,
    root_ratio,
)
from stcal.residuals import choose_arcs, select_stars


@pytest.fixture(scope="module")
def scene():
    data = simulation(4, 24, 60)
    matched = match(data.calibration.frames, data.true.camera, np.eye(3), st16_matcher())
    selection = select_stars(matched, st16_config().noise, 4)
    return data, matched, choose_arcs(selection)


def test_rms_is_the_plain_root_mean_square(scene):
    data, matched, arcs = scene
    frame = matched.frames.exposure_of_star // 2
    sums = pair_sums(arcs, frame, matched.frames.n_frames, data.initial.camera)
    errors = []
    s_d = data.initial.camera.directions(arcs.selection.row_px, arcs.selection.col_px)
    for i, j in zip(arcs.pair_i, arcs.pair_j, strict=True):
        seen = np.arccos(np.clip(s_d[i] @ s_d[j], -1, 1))
        true = np.arccos(np.clip(arcs.selection.s_i[i] @ arcs.selection.s_i[j], -1, 1))
        errors.append(seen - true)
    assert sums.rms_rad == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=1e-6)
    assert sums.pairs.sum() == len(errors)
    assert sums.pairs[~matched.frame_solved].sum() == 0


def test_bootstrap_of_a_mean_is_students_interval():
    values = np.random.default_rng(7).normal(3.0, 2.0, 400)
    interval = bootstrap(ratio, np.column_stack([values, np.ones(400)]), 0.95)
    half = 1.96 * values.std() / 20
    assert interval.value == pytest.approx(values.mean())
    assert interval.low == pytest.approx(values.mean() - half, abs=0.05)
    assert interval.high == pytest.approx(values.mean() + half, abs=0.05)


def test_bootstrap_of_long_sets_keeps_the_value_and_the_width():
    values = np.random.default_rng(8).normal(3.0, 2.0, 20_000)
    interval = bootstrap(
        ratio, Blocks.over(20_000).sum(0, np.column_stack([values, np.ones(20_000)])), 0.95
    )
    assert interval.value == pytest.approx(values.mean())
    assert interval.high - interval.low == pytest.approx(2 * 1.96 * 2 / np.sqrt(20_000), rel=0.1)


def test_statistics():
    sums = np.array([[8.0, 2.0, 3.0]])
    assert ratio(sums) == [4.0]
    assert root_ratio(sums) == [2.0]
    assert difference(sums) == [2.0]
    assert np.isnan(bootstrap(ratio, np.zeros((5, 2)), 0.95).value)


def test_residual_vectors_have_the_noise_of_the_centroids(scene):
    data, _, arcs = scene
    vectors = residual_vectors(arcs.selection, data.true.camera)
    clean = ~data.calibration.truth.outlier[arcs.selection.star]
    n = np.diff(arcs.selection.offsets)[arcs.selection.exposure]
    scaled = vectors / np.sqrt((2 * n - 3) / (2 * n))[:, None]
    sd = data.calibration.truth.sd_px[arcs.selection.star]
    assert np.sqrt(np.mean((scaled[clean] / sd[clean, None]) ** 2)) == pytest.approx(1.0, abs=0.05)


def test_coverage_counts_cells(scene):
    camera = scene[0].true.camera
    assert occupied_cells(np.array([0.0]), np.array([0.0]), camera).mean() == pytest.approx(1 / 48)
    m, n = np.meshgrid(np.arange(0, 1944, 50.0), np.arange(0, 2592, 50.0))
    assert occupied_cells(m.ravel(), n.ravel(), camera).mean() == 1.0
    assert occupied_cells(m[m < 972], n[m < 972], camera).mean() == 0.5
