"""The calibrations of one run, by every method and in every group of Wu et al. 2019, section 4.1.

A method is a residual: angular distances (AD), or singular values (SVD) of one of the paper's
models and combinations of values.  All run in the same filter on the same images.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.pipeline.filter_run import Run, run_filter
from stcal.pipeline.filtering import Variant, make_filter
from stcal.residuals import Residual
from stcal.studies.given import matched_images
from stcal.studies.wu_convergence import Convergence, convergence
from stcal.studies.wu_criteria import Pairs, distribution_arcsec, pairs_of, quadratic_forms
from stcal.studies.wu_information import (
    constant_r_estimate,
    efficient_estimate,
    full_information,
    in_own_units,
    residual_covariance,
)
from stcal.studies.wu_paper import (
    AD,
    GROUP,
    MODEL,
    MODELS,
    PAIR,
    SVD,
    VALUES,
    limiting_magnitude,
    model_key,
    values_key,
)
from stcal.studies.wu_scene import LIMITS, MeasuredImages, Scene, take_images

Floats = NDArray[np.float64]

_US = 1e6


def methods_of(group: int) -> dict[str, Residual]:
    """Return the residuals that a group compares: in the paper's group 2 all of Tables 2 and 3."""
    methods = {AD: Residual(), SVD: Residual("singular-values", MODEL, PAIR)}
    if group == GROUP:
        methods |= {model_key(m): Residual("singular-values", m, PAIR) for m in MODELS}
        methods |= {values_key(v): Residual("singular-values", MODEL, v) for v in VALUES}
    return methods


@dataclass(frozen=True)
class Criterion:
    """A criterion's mean and sd over the images, arcsec."""

    mean: float
    sd: float


@dataclass(frozen=True)
class Outcome:
    """What one method makes of one run.

    Attributes
    ----------
    error : (P,) of the estimated parameters
    a, b : the criteria
    constant_r : criterion A with one variance for all values
    expected : (D,) draws of criterion A's mean that the residual's information allows
    us_per_image, us_settled : time per image, of all and of the second half [us]
    """

    error: Floats
    a: Criterion
    b: Criterion
    constant_r: Criterion
    expected: Floats
    us_per_image: float
    us_settled: float


@dataclass(frozen=True)
class GroupRun:
    """What one run gives in one group.

    Attributes
    ----------
    calibration : its images, with true centroids
    stars : mean number of stars in an image, and with the paper's limiting magnitude
    bound : (D,) draws of criterion A's mean at the Cramer-Rao bound
    efficient : criterion A of the efficient estimate
    methods : the outcomes by method
    convergence : of AD and SVD, image by image
    """

    calibration: MeasuredImages
    stars: tuple[float, float]
    bound: Floats
    efficient: Criterion
    methods: dict[str, Outcome]
    convergence: Convergence


@dataclass(frozen=True)
class _Judge:
    """The images to judge by, with all their pairs."""

    images: MeasuredImages
    pairs: Pairs
    forms: Floats
    true: Camera

    def a(self, parameters: Floats) -> Criterion:
        """Criterion A of estimated parameters (P,): with true centroids."""
        known = self.images.known
        return self._criterion(parameters, known.row_px, known.col_px)

    def b(self, parameters: Floats) -> Criterion:
        """Criterion B: with measured centroids."""
        return self._criterion(parameters, self.images.row_px, self.images.col_px)

    def _criterion(self, parameters: Floats, row_px: Floats, col_px: Floats) -> Criterion:
        camera = self.true.with_parameters(parameters)
        by_image = self.pairs.rmse_arcsec(camera.directions(row_px, col_px))
        return Criterion(float(np.nanmean(by_image)), float(np.nanstd(by_image)))


def run_groups(scene: Scene, seed: int, run: int) -> dict[int, GroupRun]:
    """Return one run: the same images in all groups, each seeing the stars up to its limit."""
    images = take_images(scene, np.random.default_rng((seed, run)))
    return {group: _run_group(scene, images, group) for group in LIMITS}


def _run_group(scene: Scene, everything: MeasuredImages, group: int) -> GroupRun:
    images = everything.brighter(scene.brightest(LIMITS[group]))
    split, count = scene.calibration, images.known.n_images
    used, kept = images.between(0, split), images.between(split, count)
    pairs = pairs_of(kept.known)
    judge = _Judge(kept, pairs, quadratic_forms(pairs, kept.known, scene.true), scene.true)
    information = full_information(scene, used.known)
    bound = in_own_units(np.linalg.inv(information.sum(axis=0)), scene.scale)
    found = {name: _outcome(scene, used, r, judge) for name, r in methods_of(group).items()}
    paper = everything.brighter(scene.brightest(limiting_magnitude(group)))
    return GroupRun(
        calibration=used,
        stars=(len(images.known.star) / count, len(paper.known.star) / count),
        bound=distribution_arcsec(bound, judge.forms),
        efficient=judge.a(efficient_estimate(scene, used)),
        methods={name: outcome for name, (outcome, _) in found.items()},
        convergence=convergence(scene, used, {k: found[k][1] for k in (AD, SVD)}, information),
    )


def _outcome(
    scene: Scene, images: MeasuredImages, residual: Residual, judge: _Judge
) -> tuple[Outcome, Floats]:
    """Return what a method makes of a run, and its parameters (F, P) after each image."""
    run, seconds = _filter(scene, images, residual)
    found = run.camera_parameters
    covariance = residual_covariance(scene, images.known, residual)
    outcome = Outcome(
        error=found - scene.true.parameters,
        a=judge.a(found),
        b=judge.b(found),
        constant_r=judge.a(constant_r_estimate(scene, images, residual)),
        expected=distribution_arcsec(covariance, judge.forms),
        us_per_image=_US * sum(seconds) / scene.calibration,
        us_settled=_US * seconds[1] / (scene.calibration - scene.calibration // 2),
    )
    return outcome, run.filter.parameters(run.history.x)


def _filter(
    scene: Scene, images: MeasuredImages, residual: Residual
) -> tuple[Run, tuple[float, float]]:
    """Run a filter with the stars given; returns the run, and the seconds of either half.

    The time is the thread's own, so that other work on the machine doesn't count.
    """
    initial = scene.initial
    matched = matched_images(
        images.known, images.row_px, images.col_px, initial.camera, initial.sensor_id, scene.epoch
    )
    variant = Variant(residual=residual, rematch=False, shadow=False)
    chosen = make_filter(variant, initial, scene.matcher)
    first_half = np.arange(scene.calibration) < scene.calibration // 2
    halves = [matched.take(first_half), matched.take(~first_half)]
    clock = [time.thread_time()]
    run = run_filter(
        chosen, halves, chosen.start, on_fragment=lambda: clock.append(time.thread_time())
    )
    return run, (clock[1] - clock[0], clock[2] - clock[1])
