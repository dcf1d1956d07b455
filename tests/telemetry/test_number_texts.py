"""Columns of numbers as text."""

import numpy as np
import pytest

from stcal.telemetry.number_texts import number_texts


@pytest.mark.parametrize("decimals", [1, 3, 4, 9])
def test_numbers_are_written_as_printf_does(decimals):
    """Ties, negative zeros, and numbers with more digits than their product with 10^d keeps."""
    rng = np.random.default_rng(decimals)
    values = np.concatenate(
        [rng.normal(scale=10.0**power, size=200) for power in range(-9, 16, 3)]
        + [np.round(rng.normal(scale=500.0, size=500), decimals)]
        + [(rng.integers(-(10**6), 10**6, 500) + 0.5) / 10.0**decimals]
        + [np.array([0.0, -0.0, -1e-12, 0.125, 0.0625, 2.5, 1e300, np.nan])]
    )
    expected = [None if np.isnan(v) else f"{v:.{decimals}f}" for v in values.tolist()]
    assert number_texts(values, decimals).to_pylist() == expected
