"""The second stage of Zhang et al. 2024: the mounting matrix, Figure 12, Table 5, eq (53).

It takes the images that follow the first stage, the cameras that this has fitted, and the body's
attitude from another sensor, with noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.constants import DEG, URAD
from stcal.estimators.misalignment import MISALIGNMENT, Sightings
from stcal.geometry.rotations import matrix_from_vector, vector_from_matrix
from stcal.pipeline.describe_align import euler_angles
from stcal.pipeline.numbers import number, numbers
from stcal.studies.zhang_calibration import image_at
from stcal.studies.zhang_noise import CentroidNoise, draw_errors
from stcal.studies.zhang_paper import ALIGNMENT_S
from stcal.studies.zhang_runs import OURS, PAPER, Draws, MonteCarlo, Tracks, joined
from stcal.studies.zhang_scene import Scene

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Noise of the other sensor's attitude, per axis and image: 10 arcsec.
ATTITUDE_SD_URAD = 48.5
# The nine elements as the paper's filter has them, before they are made a rotation.
NINE = "nine elements"
METHODS = (NINE, *MISALIGNMENT)
# Whose star vectors the second stage takes.
TRUE = "true"
CAMERAS = (PAPER, OURS, TRUE)
_STOPS = 30


@dataclass(frozen=True)
class Mountings:
    """Estimates by one method with one camera's star vectors, in R runs after C numbers of images.

    Attributes
    ----------
    matrix : (R, C, 3, 3) of the nine elements, or rotations c_sb
    covariance : (R, C, 3, 3) rad^2 of the small rotation error about the axes of S, the method's
        own; NaN for the nine elements
    by_camera : (R, 3, 3) rad^2, what the uncertainty of the fitted camera adds to it
    """

    matrix: Floats
    covariance: Floats
    by_camera: Floats


def align_all(
    scene: Scene, tracks: Mapping[str, Tracks], monte_carlo: MonteCarlo
) -> dict[str, dict[str, Mountings]]:
    """Return the mountings by camera and method."""
    one = partial(_one_run, scene, tracks, stops_of(scene), monte_carlo.draws)
    found = list(monte_carlo.mapper(one, range(monte_carlo.runs)))
    return {
        camera: {name: joined([run[camera][name] for run in found]) for name in METHODS}
        for camera in CAMERAS
    }


def stops_of(scene: Scene) -> Ints:
    """Return after how many images the estimates are read, rising; at 200 s among them."""
    t_s = scene.alignment.t_s
    spread = np.geomspace(2, len(t_s), _STOPS).round().astype(np.int64)
    return np.unique(np.append(spread, image_at(t_s, ALIGNMENT_S) + 1))


def _one_run(
    scene: Scene, tracks: Mapping[str, Tracks], stops: Ints, draws: Draws, run: int
) -> dict[str, dict[str, Mountings]]:
    rng = draws.rng(run, 1)
    images = scene.alignment
    error = draw_errors(CentroidNoise(), images, scene.true, rng)
    turn = ATTITUDE_SD_URAD * URAD * rng.normal(size=(images.n_images, 3))
    c_bi = matrix_from_vector(turn) @ scene.c_bi[scene.calibration_images :]
    found = {}
    for name in CAMERAS:
        camera, covariance = _camera_of(scene, tracks, name, run)
        sightings = _sightings(scene, camera, error, c_bi)
        by_camera = turn_by_camera(scene, camera, covariance)
        found[name] = {
            method: Mountings(*(part[None] for part in (*estimate, by_camera)))
            for method, estimate in _estimates(sightings, stops).items()
        }
    return found


def _camera_of(
    scene: Scene, tracks: Mapping[str, Tracks], name: str, run: int
) -> tuple[Camera, Floats]:
    """Return the camera that the first stage ends with in a run, and its covariance."""
    if name == TRUE:
        return scene.true, np.zeros((len(scene.scale), len(scene.scale)))
    track = tracks[name]
    parameters = scene.true.parameters + track.error[run, -1]
    return scene.true.with_parameters(parameters), track.covariance[run]


def _sightings(scene: Scene, camera: Camera, error: Floats, c_bi: Floats) -> Sightings:
    images = scene.alignment
    row, col = images.row_px + error[0], images.col_px + error[1]
    noise = np.eye(3) * (ATTITUDE_SD_URAD * URAD) ** 2
    return Sightings(
        s_s=camera.directions(row, col),
        s_b=np.einsum("kij,kj->ki", c_bi[images.image], images.s_i),
        sd=CentroidNoise().white * camera.noise_scale(row, col),
        frame=images.image,
        attitude_covariance=np.tile(noise, (images.n_images, 1, 1)),
    )


def _estimates(sightings: Sightings, stops: Ints) -> dict[str, tuple[Floats, Floats]]:
    """Return matrices (C, 3, 3) and covariances (C, 3, 3) by method."""
    found = {name: method(sightings, stops) for name, method in MISALIGNMENT.items()}
    nine = nine_elements(sightings, stops)
    rotations = {name: (m.c_sb, m.covariance) for name, m in found.items()}
    return {NINE: (nine, np.full(nine.shape, np.nan)), **rotations}


def nine_elements(sightings: Sightings, stops: Ints) -> Floats:
    """Return the matrix (C, 3, 3) of eqs (44)-(51) after so many images, whatever its shape.

    Without process noise and with nothing known before, the filter is least squares.
    """
    last = np.searchsorted(sightings.frame, stops)
    weight = sightings.sd[:, None, None] ** -2.0
    s_b = sightings.s_b[:, None, :]
    gram = np.cumsum(weight * sightings.s_b[:, :, None] * s_b, axis=0)[last - 1]
    profile = np.cumsum(weight * sightings.s_s[:, :, None] * s_b, axis=0)[last - 1]
    return np.asarray(profile @ np.linalg.pinv(gram, hermitian=True))


def turn_by_camera(scene: Scene, camera: Camera, covariance: Floats) -> Floats:
    """Return the covariance (3, 3) [rad^2] of the turn that the camera's errors make.

    A camera that is off by dx sees stars at s + S dx, and least squares takes most of it for a
    turn: sum (1 - s s^T) e = sum s x S dx.
    """
    images = scene.alignment
    s, by_parameter, _ = camera.jacobian(images.row_px, images.col_px)
    turned = np.cross(s[:, None, :], np.swapaxes(by_parameter, 1, 2)).sum(axis=0)
    gain = np.linalg.solve(len(s) * np.eye(3) - s.T @ s, turned.T)
    return np.asarray(gain @ covariance @ gain.T)


def alignment_part(scene: Scene, found: Mapping[str, Mapping[str, Mountings]]) -> dict[str, Any]:
    """Return Figure 12, Table 5 and the matrix as the document has them."""
    stops, images = stops_of(scene), scene.alignment
    at = int(np.searchsorted(stops, image_at(images.t_s, ALIGNMENT_S) + 1))
    single = found[PAPER][NINE].matrix[:, at]
    return {
        "t_s": numbers(images.t_s[stops - 1]),
        "read_s": float(images.t_s[stops[at] - 1]),
        "attitude_sd_urad": ATTITUDE_SD_URAD,
        "c_sb": numbers(scene.c_sb),
        "matrix": {"single": numbers(single[0]), "averaged": numbers(single.mean(axis=0))},
        "cameras": {
            camera: {name: _summary(m, scene.c_sb, at) for name, m in methods.items()}
            for camera, methods in found.items()
        },
    }


def _summary(mountings: Mountings, c_sb: Floats, at: int) -> dict[str, Any]:
    """Return mean absolute errors over time, and what is read at stop ``at``.

    ``own_sd_deg`` and ``sd_deg`` are the method's own sd, and that with the camera's uncertainty,
    RMS over axes and runs; ``consistency`` the RMS error over either.
    """
    element = np.abs(mountings.matrix - c_sb)
    angle = euler_angles(mountings.matrix) - euler_angles(c_sb)
    averaged = euler_angles(mountings.matrix.mean(axis=0)) - euler_angles(c_sb)
    own = np.diagonal(mountings.covariance[:, at], axis1=1, axis2=2)
    whole = own + np.diagonal(mountings.by_camera, axis1=1, axis2=2)
    turn = vector_from_matrix(mountings.matrix[:, at] @ c_sb.T)
    absolute = np.abs(angle).mean(axis=(0, 2)) / DEG
    return {
        "element": numbers(element.mean(axis=(0, 2, 3))),
        "angle_deg": numbers(absolute),
        "read": {
            "element": number(element[:, at].mean()),
            "diagonal": number(np.diagonal(element[:, at], axis1=1, axis2=2).mean()),
            "angle_deg": number(absolute[at]),
            "averaged_angle_deg": number(np.abs(averaged[at]).mean() / DEG),
            "own_sd_deg": number(np.sqrt(own.mean()) / DEG),
            "sd_deg": number(np.sqrt(whole.mean()) / DEG),
            "own_consistency": number(np.sqrt((turn**2 / own).mean())),
            "consistency": number(np.sqrt((turn**2 / whole).mean())),
        },
    }
