from __future__ import annotations

import numpy as np
import pytest

from stcal.catalog.photometry import johnson_from_hipparcos, johnson_from_tycho

# Bessell 2000, PASP 112, 961, table 2: BT-VT, V-VT, (B-V) - (BT-VT), V-Hp of standard stars.
BESSELL = np.array(
    [
        (-0.250, 0.038, 0.031, 0.066),
        (-0.100, 0.015, 0.005, 0.021),
        (0.000, 0.001, -0.005, -0.011),
        (0.250, -0.029, -0.023, -0.069),
        (0.500, -0.054, -0.035, -0.108),
        (0.750, -0.077, -0.076, -0.134),
        (1.000, -0.098, -0.122, -0.155),
        (1.200, -0.115, -0.166, -0.162),
    ]
)


def test_tycho_magnitudes_against_standard_stars() -> None:
    tycho, v_minus_vt, to_johnson, _ = BESSELL.T
    v, colour = johnson_from_tycho(7.0 + tycho, np.full(len(tycho), 7.0))
    np.testing.assert_allclose(v, 7.0 + v_minus_vt, atol=0.017)
    np.testing.assert_allclose(colour, tycho + to_johnson, atol=0.045)


def test_hipparcos_magnitudes_against_standard_stars() -> None:
    tycho, _, to_johnson, v_minus_hp = BESSELL.T
    v = johnson_from_hipparcos(np.full(len(tycho), 7.0), tycho + to_johnson)
    np.testing.assert_allclose(v, 7.0 + v_minus_hp, atol=0.012)


def test_missing_magnitudes() -> None:
    nan = np.nan
    v, colour = johnson_from_tycho(np.array([nan, 8.0, nan]), np.array([7.0, nan, nan]))
    np.testing.assert_allclose(v[:2], [6.94, 7.30], atol=0.01)
    assert np.isnan(v[2])
    assert np.isnan(colour).all()
    alone = johnson_from_hipparcos(np.array([7.0]), np.array([nan]))[0]
    assert alone == pytest.approx(6.87, abs=0.01)
