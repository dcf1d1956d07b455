import numpy as np
import pytest

from stcal.residuals.departures import count_departures, robust_scale


def test_the_scale_is_that_of_the_median():
    values = np.random.default_rng(3).rayleigh(1.7, 20_001)
    expected = np.median(values) / np.sqrt(2.0 * np.log(2.0))
    assert robust_scale(count_departures(values)) == pytest.approx(expected, rel=5e-4)
    assert expected == pytest.approx(1.7, rel=0.02)


def test_counts_of_parts_add_up():
    values = np.random.default_rng(4).rayleigh(1.0, 1000)
    parts = [count_departures(part) for part in np.array_split(values, 7)]
    assert np.array_equal(np.sum(parts, axis=0), count_departures(values))


def test_odd_departures_are_counted_or_left_out():
    assert count_departures(np.array([0.0, 1e300, np.nan])).sum() == 2
    assert robust_scale(count_departures(np.empty(0))) == 1.0
