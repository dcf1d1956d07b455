import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from stcal.estimators.information import merge, reduce_rows, scaled


def rows(seed, count=60):
    return np.random.default_rng(seed).normal(size=(count, 9))


@given(st.lists(st.integers(0, 60), min_size=0, max_size=5))
def test_merged_partials_hold_the_normal_equations(cuts):
    everything = rows(1)
    edges = [0, *sorted(cuts), 60]
    parts = [everything[a:b] for a, b in itertools.pairwise(edges)]
    total = merge([reduce_rows(p, len(p)) for p in parts])
    np.testing.assert_allclose(total.factor.T @ total.factor, everything.T @ everything, atol=1e-10)
    assert total.rows == 60
    np.testing.assert_allclose(total.chi2, (everything[:, -1] ** 2).sum())


def test_merging_is_bitwise_repeatable():
    parts = [reduce_rows(rows(k), 60) for k in range(4)]
    assert np.array_equal(merge(parts).factor, merge(iter(parts)).factor)


def test_scaling_multiplies_the_parameter_columns_only():
    information = reduce_rows(rows(2), 60)
    scale = np.arange(1.0, 9.0)
    out = scaled(information, scale)
    np.testing.assert_allclose(out.root, information.root * scale)
    assert out.chi2 == information.chi2
