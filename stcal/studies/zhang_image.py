"""What the errors of the first stage mean on the detector: Figures 9 and 10, Table 4.

A displacement of the image that a turn of the sensor explains is no error of the camera: it is
taken out wherever the whole camera is judged.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.constants import ARCSEC
from stcal.pipeline.numbers import number, numbers
from stcal.studies.bound import image_information, pixel_jacobians
from stcal.studies.given import KnownImages
from stcal.studies.zhang_calibration import image_at, shown_images
from stcal.studies.zhang_paper import LENGTH_S, NAMES, SPOT_PX, published
from stcal.studies.zhang_runs import PAPER, Tracks
from stcal.studies.zhang_scene import Scene

Floats = NDArray[np.float64]

_GRID = 25
# Principal point and focal length: the "optical parameters" of Figure 9.
_OPTICAL = 3


def mean_square(
    scene: Scene, t_s: Floats, tracks: Mapping[str, Tracks], bound: Floats
) -> dict[str, Any]:
    """Return Figure 9: mean square errors over time [px^2].

    ``optical`` is the mean over x0, y0 and f (in pixels) and over the runs; ``averaged`` the same
    of the averaged curve; ``image`` that of the star images, per axis, over the detector.
    """
    shown = shown_images(len(t_s))
    per_px = _optical_per_px(scene)
    form = image_form(scene)
    found = {}
    for name, track in tracks.items():
        error = track.error[:, shown]
        optical = error[..., :_OPTICAL] / per_px
        found[name] = {
            "optical": numbers((optical**2).mean(axis=(0, 2))),
            "averaged": numbers((optical.mean(axis=0) ** 2).mean(axis=1)),
            "image": numbers(np.einsum("rtp,pq,rtq->t", error, form, error) / len(error)),
        }
    variance = np.diagonal(bound[shown], axis1=1, axis2=2)[:, :_OPTICAL]
    return {
        "t_s": numbers(t_s[shown]),
        "bound": {
            "optical": numbers((variance / per_px**2).mean(axis=1)),
            "image": numbers(np.einsum("tpq,pq->t", bound[shown], form)),
        },
        "filters": found,
    }


def _optical_per_px(scene: Scene) -> Floats:
    """Return the size (3,) of a pixel in the units of x0, y0 and f."""
    return np.array([1.0, 1.0, scene.true.pixel_size_m])


def image_form(scene: Scene) -> Floats:
    """Return the quadratic form (P, P) that gives the mean square displacement per axis [px^2].

    It is what one image with a star at every place of a grid tells of the camera at unit noise.
    """
    grid = grid_over(scene.true)
    told = image_information(grid, scene.true, 1.0, scene.scale)[0]
    return np.asarray(told / np.outer(scene.scale, scene.scale) / (2.0 * len(grid.star)))


def grid_over(camera: Camera) -> KnownImages:
    """Return one image with a star at every place of a grid over the detector, corners included."""
    row, col = np.meshgrid(
        np.linspace(-0.5, camera.rows - 0.5, _GRID),
        np.linspace(-0.5, camera.cols - 0.5, _GRID),
        indexing="ij",
    )
    none = np.zeros(_GRID * _GRID, dtype=np.int64)
    m, n = row.ravel(), col.ravel()
    return KnownImages(np.zeros(1), none, none, camera.directions(m, n), m, n)


def residual_distortion(scene: Scene, t_s: Floats, track: Tracks) -> dict[str, Any]:
    """Return Figure 10 after 500 s: RMS over the runs at each place [px].

    ``distortion`` is the displacement by the errors of k1 and k2 alone, as in the figure;
    ``averaged`` the same by their errors averaged over the runs; ``image`` that by the whole
    camera.  ``published`` is what the paper's coefficient errors make at the farthest corner.
    """
    grid, error = grid_over(scene.true), track.error[:, image_at(t_s, LENGTH_S)]
    coefficients = error * np.isin(NAMES, ("k1_per_px2", "k2_per_px4"))
    plain, _ = pixel_jacobians(scene.true, grid.row_px, grid.col_px)
    found = {
        "distortion": _rms_displacement(plain, coefficients),
        "averaged": _rms_displacement(plain, coefficients.mean(axis=0, keepdims=True)),
        "image": _rms_displacement(without_turn(scene.true, grid), error),
    }
    return {
        "t_s": float(t_s[image_at(t_s, LENGTH_S)]),
        "rows": scene.true.rows,
        "cols": scene.true.cols,
        "row_px": numbers(grid.row_px),
        "col_px": numbers(grid.col_px),
        **{key: numbers(values) for key, values in found.items()},
        "largest": {key: _largest(grid, values) for key, values in found.items()},
        "published": number(published_corner(scene, grid)),
    }


def _rms_displacement(jacobian: Floats, error: Floats) -> Floats:
    """Return (K,) the RMS over runs of the displacement that parameter errors (R, P) make."""
    moved = np.einsum("kip,rp->rki", jacobian, error)
    return np.asarray(np.sqrt((moved**2).sum(axis=2).mean(axis=0)))


def without_turn(camera: Camera, grid: KnownImages) -> Floats:
    """Return d(m, n)/dx (K, 2, P) over the grid, less the turn that explains most of it."""
    by_parameter, by_attitude = pixel_jacobians(camera, grid.row_px, grid.col_px)
    turns, columns = by_attitude.reshape(-1, 3), by_parameter.reshape(-1, len(NAMES))
    followed = np.linalg.lstsq(turns, columns)[0]
    return np.asarray((columns - turns @ followed).reshape(by_parameter.shape))


def _largest(grid: KnownImages, values: Floats) -> dict[str, Any]:
    k = int(np.argmax(values))
    return {"px": float(values[k]), "row_px": grid.row_px[k], "col_px": grid.col_px[k]}


def published_corner(scene: Scene, grid: KnownImages) -> float:
    """Return the largest displacement by the published errors of k1 and k2, of one sign."""
    error = np.array([[0.0, 0.0, 0.0, *(published()["error"][name] for name in NAMES[3:])]])
    plain, _ = pixel_jacobians(scene.true, grid.row_px, grid.col_px)
    return float(_rms_displacement(plain, error).max())


def spot(scene: Scene, tracks: Mapping[str, Tracks]) -> dict[str, Any]:
    """Return Table 4: the star vector of one centroid by the true, initial and fitted cameras.

    Of the fitted camera, its first run's; ``rms_arcsec`` is the angle to the true one over all.
    """
    fitted = scene.true.parameters + tracks[PAPER].error[:, -1]
    cameras = {
        "true": scene.true.parameters[None],
        "initial": scene.initial.camera.parameters[None],
        "fitted": fitted,
    }
    row, col = (np.array([value]) for value in SPOT_PX)
    vectors = {
        name: np.concatenate([scene.true.with_parameters(x).directions(row, col) for x in values])
        for name, values in cameras.items()
    }
    apart = {name: np.linalg.norm(v - vectors["true"], axis=1) for name, v in vectors.items()}
    return {
        "row_px": SPOT_PX[0],
        "col_px": SPOT_PX[1],
        "vectors": {name: numbers(v[0]) for name, v in vectors.items()},
        "rms_arcsec": {
            name: float(np.sqrt((angle**2).mean()) / ARCSEC) for name, angle in apart.items()
        },
    }
