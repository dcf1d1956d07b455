"""The consistency check on a handful of stars made for the purpose."""

import numpy as np
from scipy.spatial.transform import Rotation

from stcal.catalog.catalogue import StarCatalogue
from stcal.matching.index import build_index
from stcal.matching.kernels import Rule, StarMap, make_work
from stcal.matching.settle_kernels import settle

RULE = Rule(6e-4, 4e-4, 5e-3, 0.01, 4, 12, 1.0, 1e-5, 1e-3)
# At rest at the solar system's barycentre, far from any deflection.
OBSERVER = np.array([0.0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 1e-6])


def settled(direction, s, c):
    """(matches, star) of detections s (N, 3) from the attitude c among stars (C, 3)."""
    n = len(direction)
    catalogue = StarCatalogue(
        np.arange(n), direction, np.zeros((n, 3)), np.zeros(n), np.full(n, 4.0), np.full(n, np.nan),
        np.zeros(n, bool), np.zeros(n, bool), np.full(n, "T"),
    )  # fmt: skip
    index = build_index(catalogue, 0.0, np.radians(17.0), 5e-3)
    stars = StarMap(
        index.star, index.direction, index.cell_start, index.cell_star, index.cells,
        index.radius_rad,
    )  # fmt: skip
    slots, star = make_work(n, len(s), len(index.pair), 12).slots, np.empty(len(s), np.int32)
    slots.placed[:] = -1
    return settle(s, c.copy(), OBSERVER, stars, RULE, slots, star), star.tolist()


def field(seed, count):
    xy = np.random.default_rng(seed).uniform(-0.1, 0.1, (count, 2))
    u = np.column_stack([xy, np.ones(count)])
    return u / np.linalg.norm(u, axis=1, keepdims=True)


def test_a_star_that_becomes_the_nearest_takes_over_from_its_companion():
    s = field(1, 7)
    companion = s[0] + np.array([3e-4, 0.0, 0.0])
    direction = np.vstack([s, companion / np.linalg.norm(companion)])
    start = Rotation.from_rotvec([0.0, -2e-4, 0.0]).as_matrix()
    seen = start.T @ s[0]
    assert np.linalg.norm(seen - direction[7]) < np.linalg.norm(seen - direction[0])
    assert settled(direction, s, start) == (7, [0, 1, 2, 3, 4, 5, 6])


def test_the_nearer_of_two_detections_keeps_a_star():
    direction = field(2, 6)
    ghost = direction[0] + np.array([2e-4, 0.0, 0.0])
    s = np.vstack([ghost / np.linalg.norm(ghost), direction])
    expected = (6, [-1, 0, 1, 2, 3, 4, 5])
    assert settled(direction, s, np.eye(3)) == expected
    # In the other order as well.
    assert settled(direction, s[::-1].copy(), np.eye(3)) == (6, expected[1][::-1])
