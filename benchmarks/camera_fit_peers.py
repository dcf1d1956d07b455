"""What else fits a camera to star matches, and how far a fitted camera is from the true one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scenes import COLS, FOCAL_M, PIXEL_M, ROWS, Images
from scipy.optimize import least_squares

from stcal.attitude import solve_wahba
from stcal.cameras import Camera
from stcal.geometry.rotations import matrix_from_vector, nearest_rotation
from stcal.residuals import ARCLENGTH, StarSelection

ARCSEC = np.pi / 180.0 / 3600.0
_ITERATIONS, _SETTLED = 20, 1e-3


def detector_grid(step: float = 60.0) -> tuple[np.ndarray, np.ndarray]:
    """Return centroids (K,), (K,) over the whole detector."""
    m, n = np.meshgrid(np.arange(0, ROWS, step), np.arange(0, COLS, step), indexing="ij")
    return m.ravel(), n.ravel()


def model_error_arcsec(directions: np.ndarray, true: np.ndarray) -> float:
    """Return the rms distance of directions (K, 3), the best rotation removed."""
    turned = directions @ nearest_rotation(true.T @ directions).T
    return float(np.sqrt(np.mean(((turned - true) ** 2).sum(axis=1))) / ARCSEC)


def scipy_fit(stars: StarSelection, initial: Camera, scale: np.ndarray) -> Callable[[], Camera]:
    """least_squares with its numeric Jacobian on our arclengths."""
    bound = ARCLENGTH.bind(stars, initial)

    def at(z: np.ndarray) -> Camera:
        return initial.with_parameters(initial.parameters + z * scale)

    def fit() -> Camera:
        found = least_squares(lambda z: bound.linearise(at(z))[:, -1], np.zeros(8), method="lm")
        return at(found.x)

    return fit


def schur_fit(stars: StarSelection, initial: Camera, scale: np.ndarray) -> Callable[[], Camera]:
    """Joint Gauss-Newton over camera and attitudes in numpy, attitudes by the Schur complement.

    The residual of a star is s_d - C s_i over its sd; camera parameters in units of ``scale``.
    """
    starts, exposure = stars.offsets[:-1], stars.exposure
    sd = stars.sd_px * initial.noise_scale(stars.row_px, stars.col_px)

    def fit() -> Camera:
        camera = initial
        s_d = camera.directions(stars.row_px, stars.col_px)
        c = solve_wahba(s_d, stars.s_i, sd**-2.0, exposure, stars.n_exposures)
        for _ in range(_ITERATIONS):
            s_d, by_parameter, _ = camera.jacobian(stars.row_px, stars.col_px)
            u = np.einsum("kij,kj->ki", c[exposure], stars.s_i)
            residual, H = (s_d - u) / sd[:, None], by_parameter * scale / sd[:, None, None]
            # A rotation w of the attitude moves u by w x u.
            turn = np.zeros((len(u), 3, 3))
            x, y, z = (u / sd[:, None]).T
            turn[:, 0, 1], turn[:, 0, 2], turn[:, 1, 2] = -z, y, -x
            turn -= turn.swapaxes(1, 2)
            A = np.add.reduceat(turn.swapaxes(1, 2) @ turn, starts)
            B = np.add.reduceat(turn.swapaxes(1, 2) @ H, starts)
            b = np.add.reduceat(np.einsum("kij,ki->kj", turn, residual), starts)
            solved = np.linalg.solve(A, np.concatenate([B, b[:, :, None]], axis=2))
            flat = H.reshape(-1, H.shape[2])
            normal = flat.T @ flat - np.einsum("eip,eiq->pq", B, solved[:, :, :-1])
            right = flat.T @ residual.ravel() - np.einsum("eip,ei->p", B, solved[:, :, -1])
            step = -np.linalg.solve(normal, right)
            w = -(solved[:, :, -1] + solved[:, :, :-1] @ step)
            c = matrix_from_vector(w) @ c
            camera = camera.with_parameters(camera.parameters + step * scale)
            if np.sqrt(step @ normal @ step) < _SETTLED:
                break
        return camera

    return fit


def tetra3rs_fit(images: Images, **options: object) -> Callable[[], object]:
    """Return tetra3rs's calibration of the same centroids, which it has identified before."""
    import tetra3rs

    database = tetra3rs.SolverDatabase.generate_from_gaia(
        max_fov_deg=21.0, min_fov_deg=15.0, star_max_magnitude=6.3, epoch_proper_motion_year=2025
    )
    frames = images.frames
    fov = float(np.degrees(2 * np.arctan(COLS / 2 * PIXEL_M / FOCAL_M)))
    lists = []
    for e in range(frames.n_frames):
        part = slice(frames.star_offsets[2 * e], frames.star_offsets[2 * e + 1])
        # Origin at the centre, x right, y down; our rows count upwards.
        x, y = frames.col_px[part] - (COLS - 1) / 2, (ROWS - 1) / 2 - frames.row_px[part]
        lists.append(np.ascontiguousarray(np.stack([x, y, frames.intensity[part]], axis=1)))
    solved = [
        database.solve_from_centroids(
            c, fov_estimate_deg=fov, image_shape=(ROWS, COLS), fov_max_error_deg=0.5
        )
        for c in lists
    ]
    return lambda: database.calibrate_camera(solved, lists, image_shape=(ROWS, COLS), **options)


def tetra3rs_directions(result: object, m: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Return the directions (K, 3) of tetra3rs's camera in a frame that is turned against D."""
    camera = result.camera_model
    x, y = n - (COLS - 1) / 2, (ROWS - 1) / 2 - m
    plane = np.array([camera.pixel_to_tanplane(a, b) for a, b in zip(x, y, strict=True)])
    # x right and y down make a right-handed frame with the boresight, as D does.
    s = np.column_stack([plane[:, 0], plane[:, 1], np.ones(len(plane))])
    return s / np.linalg.norm(s, axis=1, keepdims=True)
