"""What every camera model provides, and what all of them share.

A model writes its native map from centroid to the direction (un-normalised) with both analytic
Jacobians.  Unit vectors, their Jacobians and the inverse map are common to all models.

The native map is plain arithmetic on components, so that one source serves both whole columns
(here) and one star at a time inside the compiled filters (stcal.cameras.kernels).  It therefore
indexes its parameters one by one, returns tuples, writes constants as floats, and calls nothing
that numba doesn't know for scalars.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# One component: a column (S,), or one number for all stars (or, compiled, for the one star).
Component = Floats | float
# r_d [m], along the axes of D.
Ray = tuple[Component, Component, Component]
# r_d, then dr/dx (3 x P) and dr/d(m, n) (3 x 2).
RayDerivatives = tuple[Ray, tuple[tuple[Component, ...], ...], tuple[tuple[Component, ...], ...]]

# (parameters (P,) or (P, S), pixel size, m (S,), n (S,)) -> r_d
RayMap = Callable[[Floats, float, Floats, Floats], Ray]
# the same arguments -> r_d and its derivatives
RayJacobian = Callable[[Floats, float, Floats, Floats], RayDerivatives]
# (parameters (P,) or (P, S), pixel size, s_d (S, 3)) -> (m, n), a start for the inverse
PixelGuess = Callable[[Floats, float, Floats], tuple[Floats, Floats]]
# (focal length, row and column of the principal point) -> parameters of a plain pinhole
Undistorted = Callable[[float, float, float], Floats]

_INVERSE_TOLERANCE_PX = 1e-11
_INVERSE_ITERATIONS = 50
_SLOPE_NODES = 33


@dataclass(frozen=True)
class CameraModel:
    """One camera model: names, units and the native map."""

    name: str
    parameter_names: tuple[str, ...]
    ray: RayMap
    ray_jacobian: RayJacobian
    pixel_guess: PixelGuess
    undistorted: Undistorted
    reference: str


@dataclass(frozen=True)
class Camera:
    """A camera model with its detector and its parameter values (P,).

    ``parameters`` may also be (P, S), when each of S centroids has parameters of its own (a
    drifting camera): directions, jacobian, noise_scale and project then take exactly S centroids.
    """

    model: CameraModel
    rows: int
    cols: int
    pixel_size_m: float
    parameters: Floats

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of the state vector."""
        return self.model.parameter_names

    def value(self, name: str) -> float:
        """Return one parameter by name."""
        return float(self.parameters[self.parameter_names.index(name)])

    def with_parameters(self, parameters: Floats) -> Camera:
        """Return the same camera with other parameter values."""
        return replace(self, parameters=np.array(parameters, dtype=np.float64))

    def contains(self, m: Floats, n: Floats) -> NDArray[np.bool_]:
        """(S,) whether centroids lie on the detector (pixel centres at whole numbers)."""
        return np.asarray(
            (m >= -0.5) & (m <= self.rows - 0.5) & (n >= -0.5) & (n <= self.cols - 0.5)
        )

    def directions(self, m: Floats, n: Floats) -> Floats:
        """Return unit star vectors s_d (S, 3) of centroids in pixels."""
        r = self.model.ray(self.parameters, self.pixel_size_m, m, n)
        return _unit(r, len(m))[0]

    def jacobian(self, m: Floats, n: Floats) -> tuple[Floats, Floats, Floats]:
        """Return s_d (S, 3), ds_d/dx (S, 3, P) and ds_d/d(m, n) (S, 3, 2)."""
        r, by_parameter, by_pixel = self.model.ray_jacobian(
            self.parameters, self.pixel_size_m, m, n
        )
        s, scale = _unit(r, len(m))
        return s, _tangential(s, scale, by_parameter), _tangential(s, scale, by_pixel)

    def noise_scale(self, m: Floats, n: Floats) -> Floats:
        """Return (S,) rad of direction error per pixel of isotropic centroid error.

        The root mean square over the two axes of the tangent plane, so that Enright's isotropic
        star-position error (eqs 16-17) keeps the true total variance off the axis.
        """
        r, _, by_pixel = self.model.ray_jacobian(self.parameters, self.pixel_size_m, m, n)
        across = _tangential(*_unit(r, len(m)), by_pixel)
        return np.asarray(np.sqrt(0.5 * np.einsum("sij,sij->s", across, across)))

    def noise_slope_table(self, nodes: int = _SLOPE_NODES) -> Floats:
        """Return (N, N, P) derivatives of log(noise_scale) by the parameters over the detector."""
        from stcal.cameras.kernels import CAMERA_KERNELS
        from stcal.cameras.noise_kernels import slope_table

        table = np.empty((nodes, nodes, len(self.parameters)))
        slope_table(
            CAMERA_KERNELS[self.model.name], self.parameters, self.pixel_size_m, self.rows,
            self.cols, table,
        )  # fmt: skip
        return table

    @cached_property
    def slope_table(self) -> Floats:
        """(N, N, P) the table of ``noise_slope_table``, made once for all fragments."""
        return self.noise_slope_table()

    def noise_scale_slopes(self, m: Floats, n: Floats) -> Floats:
        """Return (S, P) derivatives of log(noise_scale) by the parameters, from the table."""
        from stcal.cameras.noise_kernels import slopes_at

        out = np.empty((len(m), len(self.parameters)))
        slopes_at(self.slope_table, self.rows, self.cols, m, n, out)
        return out

    def project(self, s_d: Floats) -> tuple[Floats, Floats]:
        """Return centroids (m, n) in pixels of directions s_d (S, 3): the exact inverse map.

        Newton's method on the slopes x/z and y/z with the analytic pixel Jacobian.  NaN where a
        direction has no image (behind the camera, or outside the range in which the model is
        one-to-one).
        """
        model = self.model
        m, n = model.pixel_guess(self.parameters, self.pixel_size_m, s_d)
        step = np.full(len(m), np.inf)
        with np.errstate(all="ignore"):
            target_x, target_y = s_d[:, 0] / s_d[:, 2], s_d[:, 1] / s_d[:, 2]
            for _ in range(_INVERSE_ITERATIONS):
                r, _, by_pixel = model.ray_jacobian(self.parameters, self.pixel_size_m, m, n)
                x, y = r[0] / r[2], r[1] / r[2]
                x_m, x_n = ((by_pixel[0][k] - x * by_pixel[2][k]) / r[2] for k in range(2))
                y_m, y_n = ((by_pixel[1][k] - y * by_pixel[2][k]) / r[2] for k in range(2))
                determinant = x_m * y_n - x_n * y_m
                dm = (y_n * (target_x - x) - x_n * (target_y - y)) / determinant
                dn = (x_m * (target_y - y) - y_m * (target_x - x)) / determinant
                m, n = m + dm, n + dn
                step = np.hypot(dm, dn)
                if not np.any(step > _INVERSE_TOLERANCE_PX):
                    break
            found = (s_d[:, 2] > 0) & (step < 1e-6)
        return np.where(found, m, np.nan), np.where(found, n, np.nan)


def _unit(r: Ray, count: int) -> tuple[Floats, Floats]:
    """Return s_d (S, 3) and 1 / r (S,) of rays."""
    scale = 1.0 / np.sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2])
    s = np.empty((count, 3))
    for i in range(3):
        s[:, i] = r[i] * scale
    return s, np.asarray(scale)


def _tangential(s: Floats, scale: Floats, derivative: tuple[tuple[Component, ...], ...]) -> Floats:
    """Return derivatives (S, 3, K) of unit vectors, Enright 2018 eq (40): (I - s s^T) dr / r."""
    x, y, z = s.T.copy()
    out = np.empty((len(s), 3, len(derivative[0])))
    for k, (dx, dy, dz) in enumerate(zip(*derivative, strict=True)):
        along = x * dx + y * dy + z * dz
        out[:, 0, k] = (dx - x * along) * scale
        out[:, 1, k] = (dy - y * along) * scale
        out[:, 2, k] = (dz - z * along) * scale
    return out
