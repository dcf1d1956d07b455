"""The first stage of Zhang et al. 2024, many times over: filters on the same noisy centroids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from stcal.execution import OrderedMap, serial
from stcal.matching import Matcher
from stcal.pipeline.filter_run import run_filter
from stcal.pipeline.filtering import Filter, Variant, make_filter
from stcal.residuals import Residual
from stcal.studies.given import KnownImages, matched_images
from stcal.studies.zhang_noise import CentroidNoise, draw_errors
from stcal.studies.zhang_scene import Scene

Floats = NDArray[np.float64]
# A dataclass of arrays.
T = TypeVar("T", bound=Any)

# The paper's filter, and the project's.
PAPER, OURS = "ukf_cosine", "sqrf_arclength"
# name -> (estimator, residual)
FILTERS = {
    PAPER: ("ukf", "cosine"),
    "ukf_arclength": ("ukf", "arclength"),
    OURS: ("sqrf", "arclength"),
    "sqrf_direction": ("sqrf", "direction"),
}


@dataclass(frozen=True)
class Tracks:
    """A filter's way through the images in each of R runs.

    Attributes
    ----------
    error : (R, F, P) estimate after each image less the truth
    sd : (R, F, P) the filter's own
    covariance : (R, P, P) the filter's own, after the last image
    """

    error: Floats
    sd: Floats
    covariance: Floats


@dataclass(frozen=True)
class Draws:
    """The random numbers of all runs."""

    seed: int

    def rng(self, run: int, purpose: int) -> np.random.Generator:
        """Return the generator of a run; each purpose has its own.

        The same draws serve all noise levels, so that these compare.
        """
        return np.random.default_rng((self.seed, run, purpose))


@dataclass(frozen=True)
class MonteCarlo:
    """How runs are made: ``runs`` of them with other ``draws``, mapped."""

    runs: int
    draws: Draws
    mapper: OrderedMap = serial


def calibrate(
    scene: Scene,
    images: KnownImages,
    noise: CentroidNoise,
    names: Sequence[str],
    monte_carlo: MonteCarlo,
) -> dict[str, Tracks]:
    """Run the named filters; each knows the white noise, and takes it for all there is."""
    matcher = _matcher(scene, noise.white)
    one = partial(_one_run, scene, images, noise, names, matcher, monte_carlo.draws)
    found = list(monte_carlo.mapper(one, range(monte_carlo.runs)))
    return {name: joined([run[name] for run in found]) for name in names}


def _matcher(scene: Scene, noise_px: float) -> Matcher:
    config = scene.config
    known = config.noise.model_copy(update={"sd_px": noise_px})
    return Matcher(scene.matcher.catalogue, config.model_copy(update={"noise": known}))


def _make(scene: Scene, name: str, matcher: Matcher) -> Filter:
    method, residual = FILTERS[name]
    variant = Variant(method=method, residual=Residual(residual), rematch=False, shadow=False)
    return make_filter(variant, scene.initial, matcher)


def _one_run(
    scene: Scene,
    images: KnownImages,
    noise: CentroidNoise,
    names: Sequence[str],
    matcher: Matcher,
    draws: Draws,
    run: int,
) -> dict[str, Tracks]:
    row, col = draw_errors(noise, images, scene.true, draws.rng(run, 0))
    initial = scene.initial
    matched = matched_images(
        images, images.row_px + row, images.col_px + col, initial.camera, initial.sensor_id,
        scene.epoch,
    )  # fmt: skip
    tracks = {}
    for name in names:
        # Made anew in each run: a filter keeps its table of noise slopes, and runs share no state.
        chosen = _make(scene, name, matcher)
        found = run_filter(chosen, [matched], chosen.start)
        scale = chosen.model.scale
        tracks[name] = Tracks(
            error=chosen.parameters(found.history.x)[None] - scene.true.parameters,
            sd=(found.history.sd * scale)[None],
            covariance=(chosen.covariance(found.state) * np.outer(scale, scale))[None],
        )
    return tracks


def joined(runs: Sequence[T]) -> T:
    """Return the columns of all runs (R, ...), given as dataclasses of single ones (1, ...)."""
    columns = ([getattr(run, f.name) for run in runs] for f in fields(runs[0]))
    result: T = type(runs[0])(*map(np.concatenate, columns))
    return result
