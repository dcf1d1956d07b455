"""The scale of star departures, from counts that fragments add up to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.residuals.selection import StarSelection, reject_outliers, star_departures

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Median of the Rayleigh distribution with unit sd per axis.
_RAYLEIGH_MEDIAN = float(np.sqrt(2.0 * np.log(2.0)))
# Departures are counted in classes of equal ratio: far below any noise to far beyond any error.
_LOWEST, _HIGHEST, _RATIO = 1e-4, 1e8, 1.0005
_CLASSES = int(np.ceil(np.log(_HIGHEST / _LOWEST) / np.log(_RATIO)))


def count_departures(departures: Floats) -> Ints:
    """Return how many departures (K,) fall into each class; counts of fragments may be added."""
    known = departures[np.isfinite(departures)]
    place = np.log(np.maximum(known, _LOWEST) / _LOWEST) / np.log(_RATIO)
    return np.bincount(np.minimum(place.astype(np.int64), _CLASSES - 1), minlength=_CLASSES)


def robust_scale(counts: Ints) -> float:
    """Return the sd per axis of counted departures, from their median; 1 without any.

    The median is interpolated in its class, whose bounds differ by 0.05 %.
    """
    total = np.cumsum(counts)
    if total[-1] == 0:
        return 1.0
    half = 0.5 * total[-1]
    k = int(np.searchsorted(total, half))
    inside = (half - (total[k] - counts[k])) / counts[k]
    return float(_LOWEST * _RATIO ** (k + inside)) / _RAYLEIGH_MEDIAN


def without_outliers(
    selections: Sequence[StarSelection], camera: Camera, sigma: float, minimum: int
) -> list[StarSelection]:
    """Leave out stars beyond ``sigma`` robust sd, at a scale common to all selections."""
    counts = [count_departures(star_departures(stars, camera)) for stars in selections]
    scale = robust_scale(np.sum(counts, axis=0))
    return [reject_outliers(stars, camera, sigma, scale, minimum) for stars in selections]
