"""What the study ``estimators`` fits and judges by: telemetry with its true matches given.

All combinations get the same frames with the same stars, so that only the estimator differs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stcal.attitude import residual_angles, solve_wahba
from stcal.cameras import Camera
from stcal.config import SensorConfig
from stcal.frames import FrameBatch, MatchedFrames
from stcal.matching import Matcher
from stcal.matching.identify import rematch_given
from stcal.pipeline.parameters import parameter_scale
from stcal.residuals import Residual, select_stars
from stcal.residuals.departures import without_outliers
from stcal.simulate import Scenario, simulate
from stcal.studies.bound import image_information
from stcal.studies.given import KnownImages
from stcal.studies.scenarios import matcher_of, shortened

Floats = NDArray[np.float64]

# Directions in which cameras are compared, along each side of the detector.
_GRID = 15
# Half of the false matches are a neighbour this far off [rad], as often one distance as another on
# a logarithmic scale; the others are another star of the same exposure.
_NEIGHBOUR = (1e-3, 5e-3)


@dataclass(frozen=True)
class Scene:
    """A simulated sensor, its frames and the catalogue."""

    scenario: Scenario
    matcher: Matcher

    @property
    def config(self) -> SensorConfig:
        """The sensor's configuration."""
        return self.matcher.config


@dataclass(frozen=True)
class Sample:
    """The frames of one run.

    Attributes
    ----------
    given : the frames with their true matches; attitudes are those of the true camera
    initial, true : the camera on board, and the one that took the frames
    scale : (P,) sigma of each parameter
    bound : (P, P) Cramer-Rao bound of the parameters, in units of ``scale``
    efficient : (P,) least squares with all the information, from the true camera: what is left of
        the bound's luck in these very frames
    """

    given: MatchedFrames
    initial: Camera
    true: Camera
    scale: Floats
    bound: Floats
    efficient: Floats

    @property
    def bound_rad(self) -> float:
        """Rms error of directions [rad] that the bound allows."""
        form = quadratic_form(self.true, self.scale)
        return float(np.sqrt(np.trace(form @ self.bound)))

    def over_bound(self, parameters: Floats) -> float:
        """Return the rms error of a camera's directions over the bound's."""
        return direction_error(self.true.with_parameters(parameters), self.true) / self.bound_rad


def make_scene(scenario: Scenario, frames: int) -> Scene:
    """Return the scene of a scenario with so many frames."""
    return Scene(shortened(scenario, frames), matcher_of(scenario.sensor))


def take_sample(scene: Scene, seed: int) -> Sample:
    """Simulate the frames of one run and name their stars."""
    simulated = simulate(scene.scenario, seed)
    true, part = simulated.true.camera, simulated.calibration
    given = _true_matches(part.frames, part.truth.star_id, true, scene.matcher)
    scale = parameter_scale(scene.config, true.parameter_names)
    sd_px = scene.scenario.noise.sd_px
    information = image_information(_images(given), true, sd_px, scale).sum(axis=0)
    return Sample(
        given=given,
        initial=simulated.initial.camera,
        true=true,
        scale=scale,
        bound=np.linalg.inv(information),
        efficient=_efficient(given, true, scale, scene.config),
    )


def _efficient(given: MatchedFrames, true: Camera, scale: Floats, config: SensorConfig) -> Floats:
    """Return the parameters (P,) of one Gauss-Newton step from the true ones, outliers left out."""
    minimum = config.fit.minimum_stars_per_exposure
    stars = select_stars(given, config.noise, minimum)
    (kept,) = without_outliers([stars], true, config.fit.rejection_sigma, minimum)
    rows = Residual("direction").bind(kept, true).linearise(true)
    step = np.linalg.lstsq(rows[:, :-1] * scale, -rows[:, -1], rcond=None)[0]
    return np.asarray(true.parameters + step * scale)


def _true_matches(
    frames: FrameBatch, star_id: NDArray[np.int64], camera: Camera, matcher: Matcher
) -> MatchedFrames:
    """Return the frames with the stars that they show, where the catalogue has them."""
    catalogue = matcher.catalogue
    order = np.argsort(catalogue.star_id)
    ids = catalogue.star_id[order]
    place = np.minimum(np.searchsorted(ids, star_id), len(ids) - 1)
    star = np.where((star_id != 0) & (ids[place] == star_id), order[place], -1)
    return rematch_given(frames, camera, catalogue, star.astype(np.int32))


def _images(given: MatchedFrames) -> KnownImages:
    """Return the exposures as images; measured centroids are near enough to true ones."""
    stars, frames = given.is_matched, given.frames
    return KnownImages(
        t_s=np.zeros(frames.n_exposures),
        image=frames.exposure_of_star[stars],
        star=given.star[stars].astype(np.int64),
        s_i=given.s_i[stars],
        row_px=frames.row_px[stars],
        col_px=frames.col_px[stars],
    )


def solved_with(given: MatchedFrames, camera: Camera, s_i: Floats | None = None) -> MatchedFrames:
    """Return given matches with attitudes solved by a camera; ``s_i`` (S, 3) replaces the stars."""
    frames, stars = given.frames, given.is_matched
    exposure, directions = frames.exposure_of_star[stars], given.s_i if s_i is None else s_i
    s_d = camera.directions(frames.row_px[stars], frames.col_px[stars])
    named, weight = directions[stars], np.ones(len(s_d))
    c_di = solve_wahba(s_d, named, weight, exposure, frames.n_exposures)
    c_di[~given.solved] = np.nan
    residual = np.full(frames.n_stars, np.nan)
    residual[stars] = residual_angles(s_d, named, c_di[exposure])
    return replace(given, s_i=directions, c_di=c_di, residual=residual)


def with_false_matches(given: MatchedFrames, share: float, rng: np.random.Generator) -> Floats:
    """Return directions s_i (S, 3) of which a share belongs to wrong stars.

    Each is as often a neighbour of the right star, 1 to 5 mrad off, as another star of the same
    exposure.
    """
    stars = np.flatnonzero(given.is_matched)
    wrong = stars[rng.random(len(stars)) < share]
    exposure = given.frames.exposure_of_star
    s_i = given.s_i.copy()
    for star in wrong:
        others = stars[(exposure[stars] == exposure[star]) & (stars != star)]
        if rng.random() < 0.5 and len(others):
            s_i[star] = given.s_i[rng.choice(others)]
        else:
            s_i[star] = _neighbour(given.s_i[star], rng)
    return s_i


def _neighbour(direction: Floats, rng: np.random.Generator) -> Floats:
    across = np.cross(direction, rng.normal(size=3))
    distance = np.exp(rng.uniform(*np.log(_NEIGHBOUR)))
    turned = np.cos(distance) * direction + np.sin(distance) * across / np.linalg.norm(across)
    return np.asarray(turned)


def grid(camera: Camera) -> tuple[Floats, Floats]:
    """Return centroids (K,) spread evenly over the detector, its edges among them."""
    rows = np.linspace(0.0, camera.rows - 1.0, _GRID)
    cols = np.linspace(0.0, camera.cols - 1.0, _GRID)
    row, col = np.meshgrid(rows, cols, indexing="ij")
    return row.ravel(), col.ravel()


def direction_error(camera: Camera, true: Camera) -> float:
    """Return the rms angle [rad] between both cameras' directions over the detector.

    A common rotation counts as alignment, not as calibration: it is taken out first.
    """
    row, col = grid(true)
    found, known = camera.directions(row, col), true.directions(row, col)
    if not np.isfinite(found).all():
        return float("nan")
    one = np.zeros(len(row), dtype=np.int64)
    rotation = solve_wahba(found, known, np.ones(len(row)), one, 1)
    return float(np.sqrt(np.mean(residual_angles(found, known, rotation[one]) ** 2)))


def quadratic_form(camera: Camera, scale: Floats) -> Floats:
    """Return M (P, P): parameters off by d, in units of ``scale``, err by sqrt(d M d) in direction.

    As :func:`direction_error`, for small errors: the rms over the detector, rotation taken out.
    """
    row, col = grid(camera)
    s_d, by_parameter, _ = camera.jacobian(row, col)
    moved = (by_parameter * scale).reshape(-1, len(scale))
    turned = np.swapaxes(np.cross(np.eye(3), s_d[:, None, :]), 1, 2).reshape(-1, 3)
    left = moved - turned @ np.linalg.lstsq(turned, moved, rcond=None)[0]
    return np.asarray(left.T @ left / len(row))
