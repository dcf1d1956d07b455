"""How the calibrations converge and what they can observe: Figures 3, 4 and 6 of Wu et al. 2019."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stcal.constants import ARCSEC
from stcal.studies.bound import bound_over_images
from stcal.studies.given import KnownImages
from stcal.studies.wu_criteria import pairs_of, quadratic_forms
from stcal.studies.wu_information import in_own_units, observability_rows
from stcal.studies.wu_paper import MODEL, MODELS, PAIR, PRECISION
from stcal.studies.wu_scene import MeasuredImages, Scene
from stcal.studies.wu_values import least_observable

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Figure 6 shows the first images and some of the later ones.
_FIRST, _LATER = 20, 100


@dataclass(frozen=True)
class Convergence:
    """RMSE of the pairs of one image with the estimate after that image, arcsec.

    Attributes
    ----------
    image : (T,) number of the image, from 1
    a, b : (T,) by method: with true and with measured centroids
    bound : (T,) root mean square that the Cramer-Rao bound allows for ``a``
    """

    image: Ints
    a: dict[str, Floats]
    b: dict[str, Floats]
    bound: Floats


def shown_images(count: int) -> Ints:
    """Return numbers of images, 1 to ``count``, thinned for plotting over their logarithm."""
    later = np.geomspace(1, count, _LATER).round().astype(np.int64)
    return np.unique(np.concatenate([np.arange(1, min(count, _FIRST) + 1), later]))


def convergence(
    scene: Scene, images: MeasuredImages, tracks: Mapping[str, Floats], information: Floats
) -> Convergence:
    """Return Figure 6 of one run.

    Parameters
    ----------
    images : those of the calibration
    tracks : parameters (F, P) after each image, by method
    information : (F, P, P) of each image, in the scene's units
    """
    shown = shown_images(images.known.n_images)
    taken = images.at(shown - 1)
    pairs, camera = pairs_of(taken.known), scene.true

    def rmse(track: Floats, row_px: Floats, col_px: Floats) -> Floats:
        by_star = track[shown - 1][taken.known.image].T
        return pairs.rmse_arcsec(camera.with_parameters(by_star).directions(row_px, col_px))

    known = taken.known
    prior = np.eye(len(scene.scale)) / scene.config.sequential.initial_sd_sigma**2
    bound = in_own_units(bound_over_images(information, prior)[shown - 1], scene.scale)
    forms = quadratic_forms(pairs, known, camera)
    return Convergence(
        image=shown,
        a={name: rmse(track, known.row_px, known.col_px) for name, track in tracks.items()},
        b={name: rmse(track, taken.row_px, taken.col_px) for name, track in tracks.items()},
        bound=np.sqrt(np.einsum("tpq,tpq->t", bound, forms)) / ARCSEC,
    )


@dataclass(frozen=True)
class Observability:
    """Smallest singular value of the scaled observability matrix of each image, eq (33).

    Attributes
    ----------
    models : (F,) by model, with the last two singular values, stars in order of brightness
    outward : (F,) the same, stars in order of their distance from the principal point
    values : (F,) by singular value, in model 4
    """

    models: dict[int, Floats]
    outward: dict[int, Floats]
    values: dict[int, Floats]


def observability(scene: Scene, images: KnownImages) -> Observability:
    """Return Figures 3 and 4 at the true camera."""

    def least(taken: KnownImages, model: int, values: tuple[int, ...]) -> Floats:
        rows, image = observability_rows(scene.true, taken, model, values)
        return least_observable(rows * np.array(PRECISION), image, taken.n_images)

    outward = images_outward(scene, images)
    return Observability(
        models={model: least(images, model, PAIR) for model in MODELS},
        outward={model: least(outward, model, PAIR) for model in MODELS},
        values={value: least(images, MODEL, (value,)) for value in (1, 2, 3)},
    )


def images_outward(scene: Scene, images: KnownImages) -> KnownImages:
    """Return the images with their stars in order of distance from the principal point."""
    u0, v0 = (
        scene.true.parameters[scene.true.parameter_names.index(n)] for n in ("u0_px", "v0_px")
    )
    distance = np.hypot(images.col_px - u0, images.row_px - v0)
    order = np.lexsort((distance, images.image))
    names = ("star", "s_i", "row_px", "col_px")
    return replace(images, **{name: getattr(images, name)[order] for name in names})
