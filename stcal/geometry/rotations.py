"""Rotation vectors and matrices in the convention of ``v_a = c_ab v_b``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]


def vector_from_matrix(c: Floats) -> Floats:
    """Return rotation vectors (K, 3) [rad] of matrices (K, 3, 3) as ``c v`` turns v."""
    return np.asarray(Rotation.from_matrix(c).as_rotvec())


def nearest_rotation(matrix: Floats) -> Floats:
    """Return the rotations (..., 3, 3) nearest to matrices in the sum of squares of the elements.

    Of an attitude profile matrix, Wahba's best attitude (Markley 1988).
    """
    left, _, right = np.linalg.svd(matrix)
    left[..., 2] *= (np.linalg.det(left) * np.linalg.det(right))[..., None]
    return np.asarray(left @ right)


def matrix_from_vector(vector: Floats) -> Floats:
    """Return matrices (K, 3, 3) of rotation vectors (K, 3) [rad]."""
    return np.asarray(Rotation.from_rotvec(vector).as_matrix())
