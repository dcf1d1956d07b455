"""One camera model in place of another: least squares over the detector."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.cameras.base import Camera, CameraModel
from stcal.geometry.rotations import matrix_from_vector

Floats = NDArray[np.float64]

# Nodes along the longer side of the detector, from edge to edge.
_NODES = 41
# Relative steps below which the least squares has arrived.
_TOLERANCE = 1e-14
# Combinations of parameters that move directions by less than this share of what others do are
# not determined; they keep out of the covariance.
_UNDETERMINED = 1e-9


@dataclass(frozen=True)
class Conversion:
    """A camera in another model, and what is left of the difference.

    Attributes
    ----------
    camera : the new camera
    turn : (3, 3) rotation that takes the new camera's D frame to the old one's: models differ in
        where they put the boresight, and the alignment takes the turn up
    row_px, col_px : (G,) the grid over the detector
    error : (G, 3) rad, turned new direction minus old direction, in the old D
    error_px : (G, 2) px, centroid at which the new camera sees the old direction minus the old
        one; NaN where it has no image
    sensitivity : (P, Q) derivatives of the new parameters by the old ones
    converged : whether the least squares did
    """

    camera: Camera
    turn: Floats
    row_px: Floats
    col_px: Floats
    error: Floats
    error_px: Floats
    sensitivity: Floats
    converged: bool

    @property
    def angle(self) -> Floats:
        """(G,) rad between the old and the turned new direction."""
        return np.asarray(2.0 * np.arcsin(0.5 * np.linalg.norm(self.error, axis=1)))


def detector_grid(camera: Camera, nodes: int = _NODES) -> tuple[Floats, Floats]:
    """Return centroids (G,) of an even grid from edge to edge, ``nodes`` along the longer side."""
    longer = max(camera.rows, camera.cols)
    counts = (max(3, round(nodes * size / longer)) for size in (camera.rows, camera.cols))
    axes = [
        np.linspace(-0.5, size - 0.5, count)
        for size, count in zip((camera.rows, camera.cols), counts, strict=True)
    ]
    row, col = np.meshgrid(*axes, indexing="ij")
    return row.ravel(), col.ravel()


def convert(camera: Camera, model: CameraModel) -> Conversion:
    """Return the camera of another model whose directions depart least over the detector.

    Least squares of the direction differences on an even grid, over the new parameters and a
    rotation of D, from a plain pinhole with the old focal length and boresight.  The camera's own
    model gives the camera itself.
    """
    row, col = detector_grid(camera)
    fit = _Fit(camera, model, row, col)
    own = model is camera.model
    z, converged = (np.append(camera.parameters, np.zeros(3)), True) if own else fit.solve()
    new, turn = fit.camera(z), fit.turn(z)
    error = fit.difference(z).reshape(-1, 3)
    # What the new camera sees of the old directions; v @ turn is turn^T v.
    m, n = new.project(camera.directions(row, col) @ turn)
    return Conversion(
        camera=new,
        turn=turn,
        row_px=row,
        col_px=col,
        error=error,
        error_px=np.stack([m - row, n - col], axis=1),
        sensitivity=np.eye(len(camera.parameters)) if own else fit.sensitivity(z),
        converged=converged,
    )


class _Fit:
    """The least-squares problem; z is the new parameters (P,) and the rotation vector of turn."""

    def __init__(self, old: Camera, model: CameraModel, row: Floats, col: Floats) -> None:
        self._old, self._row, self._col = old, row, col
        self._target = old.directions(row, col)
        self._start = _start(old, model)
        self._count = len(self._start.parameters)

    def camera(self, z: Floats) -> Camera:
        """Return the new camera."""
        return self._start.with_parameters(z[: self._count])

    def turn(self, z: Floats) -> Floats:
        """Return (3, 3) from the new D to the old one."""
        return np.asarray(matrix_from_vector(z[None, self._count :])[0])

    def difference(self, z: Floats) -> Floats:
        """Return (3 G,) turned new directions minus old ones."""
        s_d = self.camera(z).directions(self._row, self._col)
        return np.asarray((s_d @ self.turn(z).T - self._target).ravel())

    def jacobian(self, z: Floats) -> Floats:
        """Return (3 G, P + 3) derivatives of the difference."""
        s_d, by_parameter, _ = self.camera(z).jacobian(self._row, self._col)
        c = self.turn(z)
        by_parameter = np.einsum("ij,gjp->gip", c, by_parameter)
        # A further small turn w of the turned directions adds w x (c s).
        crosses = np.cross(np.eye(3)[None], (s_d @ c.T)[:, None, :])
        by_turn = np.swapaxes(crosses, 1, 2) @ _left_jacobian(z[self._count :])
        return np.concatenate([by_parameter, by_turn], axis=2).reshape(-1, len(z))

    def solve(self) -> tuple[Floats, bool]:
        """Return z, and whether the least squares converged."""
        from scipy.optimize import least_squares

        found = least_squares(
            self.difference, np.append(self._start.parameters, np.zeros(3)), self.jacobian,
            method="lm", x_scale="jac", xtol=_TOLERANCE, ftol=_TOLERANCE, gtol=_TOLERANCE,
        )  # fmt: skip
        return np.asarray(found.x), bool(found.success and np.isfinite(found.fun).all())

    def sensitivity(self, z: Floats) -> Floats:
        """Return (P, Q): how the solution follows the old parameters.

        From the normal equations; the curvature of the model times what is left of the difference
        is left out, as Gauss and Newton do.
        """
        jacobian = self.jacobian(z)
        scale = 1.0 / np.linalg.norm(jacobian, axis=0)
        _, by_old, _ = self._old.jacobian(self._row, self._col)
        by_old = by_old.reshape(len(jacobian), -1)
        by_z = np.linalg.lstsq(jacobian * scale, by_old, rcond=_UNDETERMINED)[0]
        return np.asarray((scale[:, None] * by_z)[: self._count])


def _start(camera: Camera, model: CameraModel) -> Camera:
    """Return the new model's plain pinhole that looks where the camera looks."""
    m0, n0 = camera.project(np.array([[0.0, 0.0, 1.0]]))
    if not (np.isfinite(m0[0]) and np.isfinite(n0[0])):
        m0, n0 = np.array([0.5 * (camera.rows - 1)]), np.array([0.5 * (camera.cols - 1)])
    parameters = model.undistorted(camera.value("f_m"), float(m0[0]), float(n0[0]))
    return Camera(model, camera.rows, camera.cols, camera.pixel_size_m, parameters)


def _left_jacobian(vector: Floats) -> Floats:
    """Return (3, 3) d(turn)/d(rotation vector), Sola et al. 2018 eq (145)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-8:
        return np.asarray(np.eye(3) + 0.5 * cross)
    a = (1.0 - np.cos(angle)) / angle**2
    b = (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + a * cross + b * cross @ cross)
