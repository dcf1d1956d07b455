"""Celestial coordinates as vectors, and space motion between epochs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def unit_vector(ra: Floats, dec: Floats) -> Floats:
    """Return unit vectors (N, 3) of right ascension and declination (N,) in rad."""
    return np.stack((np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)), axis=-1)


def motion_vector(ra: Floats, dec: Floats, east: Floats, north: Floats) -> Floats:
    """Return the tangent vectors (N, 3) of proper motions (N,).

    ``east`` is the motion in right ascension times cos(dec); the result has the motions' unit.
    """
    zero = np.zeros_like(ra)
    to_east = np.stack((-np.sin(ra), np.cos(ra), zero), axis=-1)
    to_north = np.stack(
        (-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)), axis=-1
    )
    return np.asarray(east[..., None] * to_east + north[..., None] * to_north)


def propagate(direction: Floats, motion: Floats, years: Floats) -> tuple[Floats, Floats]:
    """Return direction and motion (N, 3) after ``years`` (N,) of uniform motion in space.

    No radial velocity: the star moves along its tangent (the IAU SOFA model, pmpx and starpm).
    """
    moved = direction + years[:, None] * motion
    length = np.linalg.norm(moved, axis=1, keepdims=True)
    unit = moved / length
    along = np.sum(motion * unit, axis=1, keepdims=True)
    return unit, np.asarray((motion - along * unit) / length)
