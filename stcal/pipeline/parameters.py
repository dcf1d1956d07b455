"""Which camera parameters are estimated, and in which units they are alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stcal.config import SensorConfig
from stcal.errors import UsageError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def parameter_scale(config: SensorConfig, names: Sequence[str]) -> Floats:
    """Return Table II's sigma (P,) of each parameter."""
    return np.array([config.camera.scale[name].sigma for name in names])


def estimated_indices(wanted: Sequence[str] | None, names: Sequence[str]) -> Ints:
    """Return the places, rising, of the ``wanted`` parameters among ``names``; all without any.

    Raises
    ------
    UsageError
        Naming what is no parameter of the camera, or given twice.
    """
    if wanted is None:
        return np.arange(len(names))
    unknown = [name for name in wanted if name not in names]
    if unknown:
        raise UsageError(
            f"no parameter of the camera: {', '.join(unknown)}; its parameters are "
            f"{', '.join(names)}"
        )
    if len(set(wanted)) != len(wanted) or not wanted:
        raise UsageError("give each parameter once, and at least one")
    return np.array(sorted(names.index(name) for name in wanted))


def embedded(covariance: Floats, free: Ints, size: int) -> Floats:
    """Return the covariance (size, size) of all parameters: zero for those held fixed."""
    full = np.zeros((size, size))
    full[np.ix_(free, free)] = covariance
    return full
