"""The initial and the true camera of a simulated sensor, and how their maps behave."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import CAMERAS, Camera
from stcal.config import SensorConfig

Floats = NDArray[np.float64]

_GRID = 41


def cameras_of(
    initial: Mapping[str, float], offset_sigma: Mapping[str, float], sensor: SensorConfig
) -> tuple[Camera, Camera]:
    """Return (initial, true) cameras.

    ``initial`` overrides the nominal values of the sensor's scale; the true camera departs from
    the initial one by ``offset_sigma`` standard deviations of that scale (Enright 2018 Tables II
    and III).
    """
    model, detector, scale = CAMERAS[sensor.camera.model], sensor.detector, sensor.camera.scale
    values = np.array([initial.get(name, scale[name].nominal) for name in model.parameter_names])
    camera = Camera(model, detector.rows, detector.cols, detector.pixel_size_m, values)
    return camera, camera.with_parameters(values + offset_of(offset_sigma, sensor))


def offset_of(offset_sigma: Mapping[str, float], sensor: SensorConfig) -> Floats:
    """Return offsets (P,) of the parameters, from standard deviations of the sensor's scale."""
    scale, names = sensor.camera.scale, CAMERAS[sensor.camera.model].parameter_names
    return np.array([offset_sigma.get(name, 0.0) * scale[name].sigma for name in names])


def is_one_to_one(camera: Camera) -> bool:
    """Whether no two points of the detector see the same direction.

    Sufficient and checked on a grid over the detector: a map of a convex region whose Jacobian has
    a definite symmetric part is one-to-one (Gale & Nikaido 1965).  The map is that to the slopes
    x/z and y/z, and every direction must lie in front of the camera.
    """
    rows = np.linspace(-0.5, camera.rows - 0.5, _GRID)
    cols = np.linspace(-0.5, camera.cols - 0.5, _GRID)
    m, n = (a.ravel() for a in np.meshgrid(rows, cols))
    with np.errstate(all="ignore"):
        s, _, by_pixel = camera.jacobian(m, n)
        slopes = s[:, :2] / s[:, 2:]
        jacobian = (by_pixel[:, :2] - slopes[:, :, None] * by_pixel[:, 2:]) / s[:, 2, None, None]
    if not np.isfinite(jacobian).all() or np.any(s[:, 2] <= 0):
        return False
    least = np.linalg.eigvalsh(0.5 * (jacobian + np.swapaxes(jacobian, 1, 2)))[:, 0]
    return bool(np.all(least > 0))


def field_of_view(camera: Camera, parameters: Floats) -> tuple[Floats, float]:
    """Return (direction of the detector's middle in D, radius [rad] of the cone of its edge).

    The middle is that of ``camera``; the cone holds the edge as cameras with any of the
    ``parameters`` (K, P) see it.
    """
    middle = camera.directions(
        np.array([0.5 * (camera.rows - 1)]), np.array([0.5 * (camera.cols - 1)])
    )[0]
    m, n = _edge(camera)
    # Most cameras don't drift, and steps are few.
    distinct = np.unique(parameters, axis=0)
    drifting = camera.with_parameters(np.repeat(distinct, len(m), axis=0).T)
    edge = drifting.directions(np.tile(m, len(distinct)), np.tile(n, len(distinct)))
    return middle, float(np.arccos(np.clip((edge @ middle).min(), -1.0, 1.0)))


def _edge(camera: Camera) -> tuple[Floats, Floats]:
    """Return centroids (m, n) along the rim of the detector."""
    step = np.linspace(-0.5, 1.0, _GRID)
    rows = np.clip(step * camera.rows, -0.5, camera.rows - 0.5)
    cols = np.clip(step * camera.cols, -0.5, camera.cols - 0.5)
    low, high = np.full(_GRID, -0.5), np.full(_GRID, 1.0)
    m = np.concatenate([rows, rows, low, high * (camera.rows - 0.5)])
    n = np.concatenate([low, high * (camera.cols - 0.5), cols, cols])
    return m, n
