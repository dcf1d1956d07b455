"""What every camera model provides, and what all of them share.

A model writes its native map from centroid to the direction (un-normalised) with both analytic
Jacobians.  Unit vectors, their Jacobians and the inverse map are common to all models.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# (parameters (P,), pixel size, m (S,), n (S,)) -> r_d (S, 3)
RayMap = Callable[[Floats, float, Floats, Floats], Floats]
# the same arguments -> (r_d (S, 3), dr/dx (S, 3, P), dr/d(m, n) (S, 3, 2))
RayJacobian = Callable[[Floats, float, Floats, Floats], tuple[Floats, Floats, Floats]]
# (parameters (P,), pixel size, s_d (S, 3)) -> (m, n), a start for the inverse
PixelGuess = Callable[[Floats, float, Floats], tuple[Floats, Floats]]

_INVERSE_TOLERANCE_PX = 1e-11
_INVERSE_ITERATIONS = 50
_SLOPE_STEP_RAD = 1e-4
_SLOPE_NODES = 33


@dataclass(frozen=True)
class CameraModel:
    """One camera model: names, units and the native map."""

    name: str
    parameter_names: tuple[str, ...]
    ray: RayMap
    ray_jacobian: RayJacobian
    pixel_guess: PixelGuess
    reference: str


@dataclass(frozen=True)
class Camera:
    """A camera model with its detector and its parameter values (P,)."""

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
        return np.asarray(r / np.sqrt(np.einsum("si,si->s", r, r))[:, None])

    def jacobian(self, m: Floats, n: Floats) -> tuple[Floats, Floats, Floats]:
        """Return s_d (S, 3), ds_d/dx (S, 3, P) and ds_d/d(m, n) (S, 3, 2).

        Normalisation by Enright 2018 eq (40): ds = (I - s s^T) dr / r.
        """
        r, by_parameter, by_pixel = self.model.ray_jacobian(
            self.parameters, self.pixel_size_m, m, n
        )
        length = np.sqrt(np.einsum("si,si->s", r, r))
        s = r / length[:, None]
        return s, _tangential(s, length, by_parameter), _tangential(s, length, by_pixel)

    def noise_scale(self, m: Floats, n: Floats) -> Floats:
        """Return (S,) rad of direction error per pixel of isotropic centroid error.

        The root mean square over the two axes of the tangent plane, so that Enright's isotropic
        star-position error (eqs 16-17) keeps the true total variance off the axis.
        """
        by_pixel = self.jacobian(m, n)[2]
        return np.asarray(np.sqrt(0.5 * np.einsum("sij,sij->s", by_pixel, by_pixel)))

    def noise_scale_slopes(self, m: Floats, n: Floats) -> Floats:
        """Return (S, P) derivatives of log(noise_scale) by the parameters.

        Central differences over steps that move directions by some 0.1 mrad, on a grid over the
        detector with linear interpolation: the slopes are smooth, and they only correct R.
        """
        axes = [np.linspace(-0.5, size - 0.5, _SLOPE_NODES) for size in (self.rows, self.cols)]
        grid_m, grid_n = (g.ravel() for g in np.meshgrid(*axes, indexing="ij"))
        moved = np.sqrt((self.jacobian(grid_m, grid_n)[1] ** 2).sum(axis=1).mean(axis=0))
        slopes = np.zeros((len(grid_m), len(moved)))
        for p in np.flatnonzero(moved > 0):
            offset = np.zeros(len(moved))
            offset[p] = _SLOPE_STEP_RAD / moved[p]
            up, down = (
                self.with_parameters(self.parameters + sign * offset).noise_scale(grid_m, grid_n)
                for sign in (1.0, -1.0)
            )
            slopes[:, p] = np.log(up / down) / (2.0 * offset[p])
        place = [
            (value + 0.5) * (_SLOPE_NODES - 1) / size
            for value, size in ((m, self.rows), (n, self.cols))
        ]
        return _bilinear(slopes.reshape(_SLOPE_NODES, _SLOPE_NODES, -1), *place)

    def project(self, s_d: Floats) -> tuple[Floats, Floats]:
        """Return centroids (m, n) in pixels of directions s_d (S, 3): the exact inverse map.

        Newton's method on the slopes x/z and y/z with the analytic pixel Jacobian.  NaN where a
        direction has no image (behind the camera, or outside the range in which the model is
        one-to-one).
        """
        model = self.model
        target, visible = _slopes(s_d)
        m, n = model.pixel_guess(self.parameters, self.pixel_size_m, s_d)
        step = np.full(len(m), np.inf)
        with np.errstate(all="ignore"):
            for _ in range(_INVERSE_ITERATIONS):
                r, _, by_pixel = model.ray_jacobian(self.parameters, self.pixel_size_m, m, n)
                slopes, _ = _slopes(r)
                derivative = (by_pixel[:, :2] - slopes[:, :, None] * by_pixel[:, 2:3]) / r[
                    :, 2, None, None
                ]
                dm, dn = _solve2(derivative, target - slopes)
                m, n = m + dm, n + dn
                step = np.hypot(dm, dn)
                if not np.any(step > _INVERSE_TOLERANCE_PX):
                    break
            found = visible & (step < 1e-6)
        return np.where(found, m, np.nan), np.where(found, n, np.nan)


def _bilinear(table: Floats, x: Floats, y: Floats) -> Floats:
    """Interpolate a table (N, N, P) at places (S,) in units of its nodes; linear beyond its rim."""
    i = np.clip(x.astype(np.int64), 0, len(table) - 2)
    j = np.clip(y.astype(np.int64), 0, len(table) - 2)
    u, v = (x - i)[:, None], (y - j)[:, None]
    low = (1.0 - v) * table[i, j] + v * table[i, j + 1]
    high = (1.0 - v) * table[i + 1, j] + v * table[i + 1, j + 1]
    return np.asarray((1.0 - u) * low + u * high)


def _tangential(s: Floats, length: Floats, derivative: Floats) -> Floats:
    along = np.einsum("si,sik->sk", s, derivative)
    return np.asarray((derivative - s[:, :, None] * along[:, None, :]) / length[:, None, None])


def _slopes(r: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    in_front = r[:, 2] > 0
    with np.errstate(all="ignore"):
        return np.asarray(r[:, :2] / r[:, 2:3]), in_front


def _solve2(a: Floats, b: Floats) -> tuple[Floats, Floats]:
    determinant = a[:, 0, 0] * a[:, 1, 1] - a[:, 0, 1] * a[:, 1, 0]
    x = (a[:, 1, 1] * b[:, 0] - a[:, 0, 1] * b[:, 1]) / determinant
    y = (a[:, 0, 0] * b[:, 1] - a[:, 1, 0] * b[:, 0]) / determinant
    return x, y
