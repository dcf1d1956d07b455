"""Residuals of one frame, as a filter binds them, are the batch's, row by row."""

import numpy as np
import pytest
from conftest import simulation, st16_config, st16_matcher

from stcal.cameras.noise_kernels import slopes_at
from stcal.matching import match
from stcal.residuals import RESIDUALS, Residual, select_stars
from stcal.residuals.kernels import RESIDUAL_KERNELS
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


def frame_rows(selection, offsets, bound_at, camera, star_slopes=None, name="arclength"):
    """Rows as the compiled pass makes them of a frame, and what they were bound to."""
    kernels = RESIDUAL_KERNELS[name]
    sd = selection.sd_px * bound_at.noise_scale(selection.row_px, selection.col_px)
    if star_slopes is None:
        star_slopes = bound_at.noise_scale_slopes(selection.row_px, selection.col_px)
    ints, floats = kernels.bind(
        offsets, np.ascontiguousarray(selection.s_i), sd, star_slopes, bound_at.parameters,
        Residual(name).options,
    )  # fmt: skip
    s_d, by_parameter, _ = camera.jacobian(selection.row_px, selection.col_px)
    out = np.full((int(ints[0]), by_parameter.shape[2] + 1), np.nan)
    kernels.rows(ints, floats, camera.parameters, s_d, by_parameter, out)
    return out, (ints, floats)


@pytest.mark.parametrize("name", RESIDUALS)
@pytest.mark.parametrize("counts", [(10, 10), (10, 4), (4, 9), (10, 0), (0, 7), (10, 2), (3, 5)])
def test_rows_of_a_frame_equal_the_batchs(data, matched, counts, name):
    """With an exposure that is empty or has hardly a star, too."""
    selection, offsets = frame_of(matched, counts)
    bound = Residual(name).bind(selection, data.true.camera)
    for camera in (data.true.camera, data.initial.camera):
        expected = bound.linearise(camera)
        rows, (ints, _) = frame_rows(selection, offsets, data.true.camera, camera, name=name)
        scale = np.abs(expected).max(axis=0)
        np.testing.assert_allclose(rows / scale, expected / scale, atol=1e-9)
        assert ints[1] == bound.dependent


@pytest.mark.parametrize("counts", [(10, 10), (10, 4), (10, 0), (10, 2), (3, 5)])
def test_arcs_of_a_frame_are_2n_minus_3_an_exposure(data, matched, counts):
    selection, offsets = frame_of(matched, counts)
    rows, _ = frame_rows(selection, offsets, data.true.camera, data.initial.camera)
    assert len(rows) == sum(max(2 * n - 3, 0) for n in counts)


@pytest.mark.parametrize("name", RESIDUALS)
@pytest.mark.parametrize("counts", [(0, 0), (1, 0), (0, 1), (1, 1)])
def test_a_frame_without_pairs_has_no_rows(data, matched, counts, name):
    selection, offsets = frame_of(matched, counts)
    rows, (ints, _) = frame_rows(selection, offsets, data.true.camera, data.true.camera, name=name)
    assert not rows[:, :8].any()
    assert ints[0] == ints[1]


@pytest.mark.parametrize("name", RESIDUALS)
def test_the_exposures_of_a_frame_do_not_mix(data, matched, name):
    """Rows are of stars of one exposure, and whitening starts anew in the second."""
    selection, offsets = frame_of(matched, (8, 6))
    rows, _ = frame_rows(selection, offsets, data.true.camera, data.initial.camera, name=name)
    alone, _ = frame_rows(
        *frame_of(matched, (8, 0)), data.true.camera, data.initial.camera, name=name
    )
    np.testing.assert_allclose(rows[: len(alone)], alone, rtol=1e-12)


def test_a_dependent_arc_becomes_a_row_of_zeros(data):
    angle = np.radians([0.0, 3.0, 7.0])
    s = np.column_stack([np.sin(angle), np.zeros(3), np.cos(angle)])
    camera = data.true.camera
    m, n = camera.project(s)
    line = StarSelection(np.arange(3), np.zeros(3, int), m + 0.3, n, s, np.full(3, 0.3), 1)
    rows, (ints, _) = frame_rows(line, np.array([0, 3, 3]), camera, camera)
    assert ints[1] == 1
    assert (~rows.any(axis=1)).sum() == 1


@pytest.mark.parametrize("name", RESIDUALS)
def test_residuals_alone_need_no_derivatives(data, matched, name):
    selection, offsets = frame_of(matched, (9, 5))
    camera = data.initial.camera
    rows, bound = frame_rows(selection, offsets, data.true.camera, camera, name=name)
    s_d, by_parameter, _ = camera.jacobian(selection.row_px, selection.col_px)
    alone = np.empty((len(rows), 1))
    RESIDUAL_KERNELS[name].rows(*bound, camera.parameters, s_d, np.empty((len(s_d), 3, 0)), alone)
    np.testing.assert_array_equal(alone[:, 0], rows[:, -1])
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
