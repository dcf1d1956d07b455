import numpy as np
import pytest
from conftest import st16_matcher

from stcal.errors import InputError
from stcal.matching.index import build_index, cube_cell
from stcal.matching.kernels import StarMap
from stcal.matching.verify_kernels import cell_of, nearest_star


@pytest.fixture(scope="module")
def index():
    return build_index(st16_matcher().catalogue, 14.0, np.radians(6.0), 0.006)


def directions(count, seed):
    v = np.random.default_rng(seed).normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def as_map(index):
    return StarMap(
        index.star, index.direction, index.cell_start, index.cell_star, index.cells,
        index.radius_rad,
    )  # fmt: skip


def test_the_kernel_and_numpy_agree_on_cells(index):
    u = directions(5000, 1)
    expected = cube_cell(u, index.cells)
    assert [cell_of(*v, index.cells) for v in u] == expected.tolist()
    for cells in (89, 90):
        assert 0 <= cell_of(np.nan, np.nan, np.nan, cells) < 6 * cells**2


def test_a_look_up_finds_the_nearest_star_as_brute_force_does(index):
    stars, rng = as_map(index), np.random.default_rng(2)
    star = rng.integers(0, len(index.star), 4000)
    u = index.direction[star] + rng.normal(0, 0.003, (4000, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    distance = np.linalg.norm(u[:, None] - index.direction[None, :], axis=2)
    nearest = np.where(distance.min(axis=1) < 0.006, distance.argmin(axis=1), -1)
    assert [nearest_star(*v, 0.006, stars) for v in u] == nearest.tolist()
    assert (nearest >= 0).any()
    assert (nearest < 0).any()


def test_within_half_the_gap_no_other_star_is_nearer(index):
    distance = np.linalg.norm(index.direction[:300, None] - index.direction[None], axis=2)
    distance[np.arange(300), np.arange(300)] = np.inf
    np.testing.assert_allclose(index.star[:300, 7], 0.5 * distance.min(axis=1), rtol=1e-12)


def test_pairs_are_all_pairs_within_the_limit(index):
    u = index.direction[:700]
    cosine = u @ u.T
    expected = int((np.triu(cosine, 1) > np.cos(np.radians(6.0))).sum())
    listed = (index.pair < 700).all(axis=1)
    assert listed.sum() == expected
    angle = np.arccos(
        np.clip(
            index.direction[index.pair].prod(axis=1).sum(axis=1),
            -1,
            1,
        )
    )
    np.testing.assert_allclose(index.pair_angle, angle, atol=2e-6)
    assert (np.diff(index.pair_angle) >= 0).all()


def test_fast_stars_are_indexed_where_they_are(index):
    catalogue = st16_matcher().catalogue
    fastest = int(np.linalg.norm(catalogue.motion, axis=1).argmax())
    moved = np.linalg.norm(index.direction[fastest] - catalogue.direction[fastest])
    assert moved == pytest.approx(14.0 * np.linalg.norm(catalogue.motion[fastest]), rel=1e-3)
    assert moved > 2e-4


def test_only_seed_stars_make_pairs():
    catalogue = st16_matcher().catalogue
    index = build_index(catalogue, 0.0, np.radians(6.0), 0.006, seed_magnitude=4.0)
    assert catalogue.magnitude[index.pair].max() <= 4.0
    assert len(index.pair) > 100


def test_more_stars_than_the_table_can_hold_are_refused(monkeypatch):
    monkeypatch.setattr("stcal.matching.index._MOST_STARS", 100)
    with pytest.raises(InputError, match="at most 100"):
        build_index(st16_matcher().catalogue, 0.0, np.radians(6.0), 0.006)
