import numpy as np
import pytest
from conftest import st16_matcher

from stcal.errors import InputError
from stcal.matching.index import build_index, cube_cell
from stcal.matching.kernels import Sky
from stcal.matching.verify_kernels import cell_of, nearest_star


@pytest.fixture(scope="module")
def index():
    return build_index(st16_matcher().catalogue, 14.0, np.radians(6.0), 0.006)


def directions(count, seed):
    v = np.random.default_rng(seed).normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def as_sky(index):
    return Sky(
        index.direction, index.motion, index.parallax, index.epoch_direction, index.pair_angle,
        index.pair_a, index.pair_b, index.pair_start, index.pair_bin_rad, np.radians(6.0),
        index.cell_start, index.cell_star, index.cells, index.radius_rad,
    )  # fmt: skip


def test_the_kernel_and_numpy_agree_on_cells(index):
    u = directions(5000, 1)
    expected = cube_cell(u, index.cells)
    assert [cell_of(v, index.cells) for v in u] == expected.tolist()


def test_a_look_up_finds_the_nearest_star_as_brute_force_does(index):
    sky, rng = as_sky(index), np.random.default_rng(2)
    star = rng.integers(0, len(index.parallax), 4000)
    u = index.epoch_direction[star] + rng.normal(0, 0.003, (4000, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    distance = np.linalg.norm(u[:, None] - index.epoch_direction[None, :], axis=2)
    nearest = np.where(distance.min(axis=1) < 0.006, distance.argmin(axis=1), -1)
    assert [nearest_star(v, 0.006, sky) for v in u] == nearest.tolist()
    assert (nearest >= 0).any()
    assert (nearest < 0).any()


def test_pairs_are_all_pairs_within_the_limit(index):
    u = index.epoch_direction[:700]
    cosine = u @ u.T
    expected = int((np.triu(cosine, 1) > np.cos(np.radians(6.0))).sum())
    listed = (index.pair_a < 700) & (index.pair_b < 700)
    assert listed.sum() == expected
    angle = np.arccos(
        np.clip(
            (index.epoch_direction[index.pair_a] * index.epoch_direction[index.pair_b]).sum(axis=1),
            -1,
            1,
        )
    )
    np.testing.assert_allclose(index.pair_angle, angle, atol=2e-6)
    assert (np.diff(index.pair_angle) >= 0).all()


def test_fast_stars_are_indexed_where_they_are(index):
    catalogue = st16_matcher().catalogue
    fastest = int(np.linalg.norm(catalogue.motion, axis=1).argmax())
    moved = np.linalg.norm(index.epoch_direction[fastest] - catalogue.direction[fastest])
    assert moved == pytest.approx(14.0 * np.linalg.norm(catalogue.motion[fastest]), rel=1e-3)
    assert moved > 2e-4


def test_only_seed_stars_make_pairs():
    catalogue = st16_matcher().catalogue
    index = build_index(catalogue, 0.0, np.radians(6.0), 0.006, seed_magnitude=4.0)
    assert catalogue.magnitude[index.pair_a].max() <= 4.0
    assert catalogue.magnitude[index.pair_b].max() <= 4.0
    assert len(index.pair_a) > 100


def test_more_stars_than_the_table_can_hold_are_refused(monkeypatch):
    monkeypatch.setattr("stcal.matching.index._MOST_STARS", 100)
    with pytest.raises(InputError, match="at most 100"):
        build_index(st16_matcher().catalogue, 0.0, np.radians(6.0), 0.006)
