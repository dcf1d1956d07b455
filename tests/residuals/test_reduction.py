"""The factor of a fragment, folded block by block, is that of its whitened rows."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import simulation, st16_config, st16_matcher

from stcal.matching import match
from stcal.residuals import RESIDUALS, Residual, bound, choose_arcs, select_stars
from stcal.residuals.arclength_kernels import arc_stars
from stcal.residuals.block_kernels import fold
from stcal.residuals.selection import star_departures

SIGMA = np.array([8e-6, 30.0, 30.0, 1e8, 1e3, 0.01, 0.01, 2e-4])


@pytest.fixture(scope="module")
def data():
    return simulation(4, 21, 60)


@pytest.fixture(scope="module")
def stars(data):
    matched = match(data.calibration.frames, data.true.camera, np.eye(3), st16_matcher())
    return select_stars(matched, st16_config().noise, 4)


@pytest.mark.parametrize("name", RESIDUALS)
@pytest.mark.parametrize("free", [np.arange(8), np.array([0, 3, 7])])
def test_the_factor_is_that_of_the_rows(data, stars, name, free, monkeypatch):
    """At a camera other than the one bound at, over blocks that don't divide the exposures."""
    whole = Residual(name).bind(stars, data.true.camera)
    monkeypatch.setattr(bound, "_EXPOSURES", 7)
    blocks = Residual(name).bind(stars, data.true.camera)
    assert len(blocks.blocks) > 10
    assert (blocks.rows, blocks.dependent) == (whole.rows, whole.dependent)
    camera = data.initial.camera
    rows = whole.linearise(camera)
    np.testing.assert_array_equal(blocks.linearise(camera), rows)
    scale = np.append(SIGMA, 1.0)[np.append(free, 8)]
    expected = np.linalg.qr(rows[:, np.append(free, 8)] * scale, mode="r")
    for some in (whole, blocks):
        factor = some.reduce(camera, free) * scale
        assert not np.tril(factor, -1).any()
        signs = np.sign(np.diag(factor)) * np.sign(np.diag(expected))
        size = np.abs(expected).max(axis=0)
        np.testing.assert_allclose(signs[:, None] * factor / size, expected / size, atol=1e-11)


def test_the_residual_has_the_arcs_of_the_metrics(data, stars, monkeypatch):
    monkeypatch.setattr(bound, "_EXPOSURES", 7)
    arcs, first = choose_arcs(stars), 0
    for block in Residual().bind(stars, data.true.camera).blocks:
        pair_i, pair_j, starts = arc_stars(block.ints)
        mine = slice(first, first + len(pair_i))
        assert np.array_equal(pair_i + block.first, arcs.pair_i[mine])
        assert np.array_equal(pair_j + block.first, arcs.pair_j[mine])
        assert np.array_equal(starts + first, arcs.starts[mine])
        first += len(pair_i)
    assert first == len(arcs)


def test_reduction_is_bitwise_repeatable(data, stars):
    for _ in range(2):
        factors = [
            Residual().bind(stars, data.true.camera).reduce(data.initial.camera, np.arange(8))
            for _ in range(2)
        ]
        assert np.array_equal(*factors)


def test_columns_of_any_layout_will_do(data, stars):
    """Views into a table, and arrays that may not be written to."""
    table = np.column_stack([stars.row_px, stars.col_px, stars.sd_px, stars.s_i])
    table.flags.writeable = False
    views = replace(
        stars, row_px=table[:, 0], col_px=table[:, 1], sd_px=table[:, 2], s_i=table[:, 3:]
    )
    camera, free = data.initial.camera, np.arange(8)
    factors = [
        Residual().bind(some, data.true.camera).reduce(camera, free) for some in (stars, views)
    ]
    assert np.array_equal(*factors)
    assert np.array_equal(star_departures(views, camera), star_departures(stars, camera))


def test_nothing_gives_a_factor_of_zeros(data, stars):
    none = stars.keep(np.zeros(len(stars.star), dtype=bool), 4)
    assert not Residual().bind(none, data.true.camera).reduce(data.true.camera, np.arange(8)).any()


@pytest.mark.parametrize("count", [1, 5, 47, 48, 49, 300])
def test_rows_are_folded_into_what_is_there(count):
    rng = np.random.default_rng(count)
    before, rows = rng.normal(size=(9, 9)), rng.normal(size=(count, 12))
    columns = np.array([0, 2, 3, 4, 5, 7, 8, 10, 11])
    factor = np.triu(before)
    fold(rows, columns, factor)
    total = np.triu(before).T @ np.triu(before) + rows[:, columns].T @ rows[:, columns]
    np.testing.assert_allclose(factor.T @ factor, total, atol=1e-11)
    assert not np.tril(factor, -1).any()
