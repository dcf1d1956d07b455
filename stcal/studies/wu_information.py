"""What the images of a run can tell of the camera at most, and estimates in one step.

The bound is that of the centroids themselves; that of a residual is what it keeps of it.  A run's
error is random: beside the bound's expectation stands the efficient estimate of the same data.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.residuals import Residual, StarSelection, select_stars
from stcal.studies.bound import image_information
from stcal.studies.given import KnownImages, matched_images
from stcal.studies.wu_criteria import pairs_of, separation_rows
from stcal.studies.wu_scene import MeasuredImages, Scene
from stcal.studies.wu_values import derivatives, groups_of, singular_values

Floats = NDArray[np.float64]


def full_information(scene: Scene, images: KnownImages) -> Floats:
    """Return what each image tells of the camera (F, P, P), its attitude projected out.

    In the scene's units of the parameters.
    """
    return image_information(images, scene.true, scene.config.noise.sd_px, scene.scale)


def in_own_units(covariance: Floats, scale: Floats) -> Floats:
    """Return covariances (..., P, P) in units of ``scale`` (P,) in the parameters' own."""
    return covariance * np.outer(scale, scale)


def residual_covariance(scene: Scene, images: KnownImages, residual: Residual) -> Floats:
    """Return the covariance (P, P) of an efficient estimate from a residual alone."""
    true = MeasuredImages(images, images.row_px, images.col_px)
    rows, scale = _whitened(scene, true, residual)[:, :-1], scene.scale
    scaled = rows * scale
    return in_own_units(np.asarray(np.linalg.inv(scaled.T @ scaled), dtype=np.float64), scale)


def efficient_estimate(scene: Scene, images: MeasuredImages) -> Floats:
    """Return the parameters (P,) of least squares with all the information, from the true ones.

    One Gauss-Newton step suffices: the error is far below what the camera is not linear in.
    """
    rows = _whitened(scene, images, Residual("direction"))
    return scene.true.parameters + _least_squares(rows[:, :-1], rows[:, -1], scene.scale)


def _whitened(scene: Scene, images: MeasuredImages, residual: Residual) -> Floats:
    """Return whitened rows (A, P + 1) at the true camera."""
    selection = _selection(scene, images)
    return residual.bind(selection, scene.true).linearise(scene.true)


def _selection(scene: Scene, images: MeasuredImages) -> StarSelection:
    matched = matched_images(
        images.known, images.row_px, images.col_px, scene.true, scene.initial.sensor_id,
        scene.epoch,
    )  # fmt: skip
    config = scene.config
    return select_stars(matched, config.noise, config.fit.minimum_stars_per_exposure)


def constant_r_estimate(scene: Scene, images: MeasuredImages, residual: Residual) -> Floats:
    """Return the parameters (P,) that a filter ends at with one variance for all its values.

    The simplest reading of the paper, which doesn't give its R.  Of angular distances all pairs are
    used.
    """
    s_d, by_parameter, _ = scene.true.jacobian(images.row_px, images.col_px)
    if residual.name == "arclength":
        rows, error = separation_rows(pairs_of(images.known), s_d, by_parameter)
    else:
        _, first, size = groups_of(images.known.offsets, residual.groups)
        which = np.array(residual.values) - 1
        by_catalogue = singular_values(images.known.s_i, first, size)[0][:, which]
        error = (singular_values(s_d, first, size)[0][:, which] - by_catalogue).ravel()
        moved = derivatives(s_d, by_parameter, first, size)[:, which]
        rows = moved.reshape(-1, moved.shape[2])
    return scene.true.parameters + _least_squares(rows, error, scene.scale)


def _least_squares(rows: Floats, error: Floats, scale: Floats) -> Floats:
    """Return the step (P,) that takes the errors (A,) away, rows (A, P) being their derivatives."""
    scaled = rows * scale
    return -np.linalg.solve(scaled.T @ scaled, scaled.T @ error) * scale


def observability_rows(
    camera: Camera, images: KnownImages, model: int, values: tuple[int, ...]
) -> tuple[Floats, NDArray[np.int64]]:
    """Return H (A, P) of singular values at true centroids, and each row's image (A,), eq (28)."""
    s_d, by_parameter, _ = camera.jacobian(images.row_px, images.col_px)
    image, first, size = groups_of(images.offsets, model)
    moved = derivatives(s_d, by_parameter, first, size)[:, np.array(values) - 1]
    return moved.reshape(-1, moved.shape[2]), np.repeat(image, len(values))
