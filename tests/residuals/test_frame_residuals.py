"""Residuals of one frame are the batch's, row by row."""

import numpy as np
import pytest
from conftest import simulation, st16_config, st16_matcher

from stcal.cameras.noise_kernels import slopes_at
from stcal.matching import match
from stcal.residuals import select_stars
from stcal.residuals.arclength import bind_arclength
from stcal.residuals.frame_kernels import bind_frame, whiten_frame
from stcal.residuals.selection import StarSelection

MINIMUM = 4


@pytest.fixture(scope="module")
def data():
    return simulation(4, 21, 60)


@pytest.fixture(scope="module")
def matched(data):
    return match(data.calibration.frames, data.true.camera, np.eye(3), st16_matcher())


def frame_of(matched, counts):
    """The first stars of a frame's two exposures, as a selection and as the frame's offsets."""
    rich = np.flatnonzero((matched.matches_per_exposure.reshape(-1, 2) >= 10).all(axis=1))[0]
    stars = select_stars(matched.take(np.array([rich])), st16_config().noise, MINIMUM)
    keep = np.concatenate([np.flatnonzero(stars.exposure == e)[:n] for e, n in enumerate(counts)])
    number = np.unique(stars.exposure[keep], return_inverse=True)[1]
    chosen = StarSelection(
        np.arange(len(keep)), number, stars.row_px[keep], stars.col_px[keep], stars.s_i[keep],
        0.3 + 0.02 * np.arange(len(keep)), int(number.max(initial=-1)) + 1,
    )  # fmt: skip
    return chosen, np.concatenate(([0], np.cumsum(counts)))


def frame_rows(selection, offsets, bound_at, camera, star_slopes=None):
    sd = selection.sd_px * bound_at.noise_scale(selection.row_px, selection.col_px)
    if star_slopes is None:
        star_slopes = bound_at.noise_scale_slopes(selection.row_px, selection.col_px)
    arcs = bind_frame(offsets, selection.s_i, sd, star_slopes, bound_at.parameters)
    s_d, by_parameter, _ = camera.jacobian(selection.row_px, selection.col_px)
    out = np.full((len(arcs.arc), by_parameter.shape[2] + 1), np.nan)
    whiten_frame(arcs, camera.parameters, s_d, by_parameter, out)
    return out, arcs


@pytest.mark.parametrize("counts", [(10, 10), (10, 4), (4, 9), (10, 0), (0, 7), (10, 2), (3, 5)])
def test_rows_of_a_frame_equal_the_batchs(data, matched, counts):
    """With an exposure that is empty or has hardly a star, too."""
    selection, offsets = frame_of(matched, counts)
    bound = bind_arclength(selection, data.true.camera)
    for camera in (data.true.camera, data.initial.camera):
        expected = bound.linearise(camera)
        rows, arcs = frame_rows(selection, offsets, data.true.camera, camera)
        assert len(rows) == sum(max(2 * n - 3, 0) for n in counts)
        scale = np.abs(expected).max(axis=0)
        np.testing.assert_allclose(rows / scale, expected / scale, atol=1e-9)
        assert arcs.dependent == bound.dependent
    assert np.array_equal(arcs.pair_i, bound.pair_i)
    assert np.array_equal(arcs.pair_j, bound.pair_j)


@pytest.mark.parametrize("counts", [(0, 0), (1, 0), (0, 1), (1, 1)])
def test_a_frame_without_pairs_has_no_rows(data, matched, counts):
    selection, offsets = frame_of(matched, counts)
    rows, arcs = frame_rows(selection, offsets, data.true.camera, data.true.camera)
    assert rows.shape == (0, 9)
    assert arcs.dependent == 0


def test_the_exposures_of_a_frame_do_not_mix(data, matched):
    """Arcs join stars of one exposure, and whitening starts anew in the second."""
    selection, offsets = frame_of(matched, (8, 6))
    rows, arcs = frame_rows(selection, offsets, data.true.camera, data.initial.camera)
    assert ((arcs.pair_i < 8) == (arcs.pair_j < 8)).all()
    alone, _ = frame_rows(*frame_of(matched, (8, 0)), data.true.camera, data.initial.camera)
    np.testing.assert_allclose(rows[:13], alone, rtol=1e-12)


def test_a_dependent_arc_becomes_a_row_of_zeros(data):
    angle = np.radians([0.0, 3.0, 7.0])
    s = np.column_stack([np.sin(angle), np.zeros(3), np.cos(angle)])
    camera = data.true.camera
    m, n = camera.project(s)
    line = StarSelection(np.arange(3), np.zeros(3, int), m + 0.3, n, s, np.full(3, 0.3), 1)
    rows, arcs = frame_rows(line, np.array([0, 3, 3]), camera, camera)
    assert arcs.dependent == 1
    assert (~rows.any(axis=1)).sum() == 1


def test_residuals_alone_need_no_derivatives(data, matched):
    selection, offsets = frame_of(matched, (9, 5))
    rows, arcs = frame_rows(selection, offsets, data.true.camera, data.initial.camera)
    camera = data.initial.camera
    s_d, by_parameter, _ = camera.jacobian(selection.row_px, selection.col_px)
    alone = np.empty((len(rows), 1))
    whiten_frame(arcs, camera.parameters, s_d, np.empty((len(s_d), 3, 0)), alone)
    assert np.array_equal(alone[:, 0], rows[:, -1])
    assert by_parameter.shape[2] + 1 == rows.shape[1]


def test_a_coarse_table_of_noise_slopes_is_fine_enough(data, matched):
    """The filters make it anew while they move, with 17 nodes; the batch has 33."""
    selection, offsets = frame_of(matched, (10, 10))
    camera = data.true.camera
    table = camera.noise_slope_table(17)
    slopes = np.empty((len(selection.star), table.shape[2]))
    slopes_at(table, camera.rows, camera.cols, selection.row_px, selection.col_px, slopes)
    fine, _ = frame_rows(selection, offsets, camera, data.initial.camera)
    coarse, _ = frame_rows(selection, offsets, camera, data.initial.camera, slopes)
    # A tenth of a percent of the largest entry of each column.
    scale = np.abs(fine).max(axis=0)
    np.testing.assert_allclose(coarse / scale, fine / scale, atol=1e-3)
