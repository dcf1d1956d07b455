"""The true camera in time: it follows the sensor's temperature, ages, and may jump."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.config import SensorConfig
from stcal.constants import DAY_S
from stcal.simulate.orbit import Orbit
from stcal.simulate.sections import Drift
from stcal.simulate.true_camera import offset_of

Floats = NDArray[np.float64]

# Just before a step: the resolution of its time.
_MOMENT_S = 1e-3


def warmth_at(swing_c: float, orbit: Orbit, t_s: Floats) -> Floats:
    """Return (T,) K of the sensor above its reference temperature, at times since the epoch."""
    return np.asarray(swing_c * np.sin(2.0 * np.pi * t_s / orbit.nodal_period_s))


def parameters_at(
    true: Camera, drift: Drift, sensor: SensorConfig, t_s: Floats, warmth: Floats
) -> Floats:
    """Return the true camera's parameters (T, P).

    Parameters
    ----------
    true : the camera at the epoch and at the reference temperature
    t_s : (T,) s since the scenario's epoch
    warmth : (T,) K above the reference temperature
    """
    offset = np.outer(warmth, offset_of(drift.per_kelvin, sensor))
    offset += np.outer(t_s / DAY_S, offset_of(drift.per_day, sensor))
    for step in drift.steps:
        offset += np.outer(t_s >= step.at_s, offset_of(step.offset_sigma, sensor))
    return np.asarray(true.parameters + offset)


def extremes(drift: Drift, swing_c: float, last_s: float) -> tuple[Floats, Floats]:
    """Return (times (K,), K above the reference (K,)) between which all cameras lie.

    The epoch, the last frame, and both sides of every step; cold and warm.
    """
    steps = np.array([step.at_s for step in drift.steps])
    times = np.sort(np.concatenate(([0.0, last_s], steps - _MOMENT_S, steps)))
    return np.repeat(times, 2), np.tile([-swing_c, swing_c], len(times))
