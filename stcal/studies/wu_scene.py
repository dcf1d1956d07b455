"""The scene of the study ``wu``: the sensor, its cameras, and what it sees; Wu et al. 2019, 4.1.

The paper doesn't say where its sensor points: here every image has a random attitude.  On average
over the sky its limiting magnitudes 6, 5.5 and 4.6 show fewer stars than it states (27.6, 15.6 and
5.6); they are set somewhat fainter, so that the numbers of stars are the paper's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stcal.calibration import Calibration
from stcal.cameras import Camera
from stcal.config import SensorConfig
from stcal.errors import ConfigError
from stcal.matching import Matcher
from stcal.pipeline.parameters import parameter_scale
from stcal.simulate.sky import Sky
from stcal.simulate.true_camera import cameras_of
from stcal.studies.given import KnownImages, known_images
from stcal.studies.scenarios import matcher_of
from stcal.studies.wu_paper import INITIAL
from stcal.times import parse_utc

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Limiting magnitude by group.
LIMITS = {1: 6.12, 2: 5.68, 3: 4.88}
SENSOR_ID = "WU-1"
_CAMERA = "pinhole-radial"
_IMAGES_PER_S = 2.0
_EPOCH_TAI_NS = parse_utc("2019-06-01T00:00:00Z")


@dataclass(frozen=True)
class Scene:
    """What all runs share.

    Attributes
    ----------
    matcher : the deepest group's catalogue, and the configuration with this study's prior
    true : the camera that takes the images, of Table 1's nominal values
    initial : where every calibration starts
    calibration, evaluation : number of images to calibrate with, and to judge by
    """

    matcher: Matcher
    true: Camera
    initial: Calibration
    calibration: int
    evaluation: int

    @property
    def config(self) -> SensorConfig:
        """The sensor's configuration."""
        return self.matcher.config

    @property
    def scale(self) -> Floats:
        """Sigma (P,) of each parameter."""
        return parameter_scale(self.config, self.true.parameter_names)

    @property
    def epoch(self) -> int:
        """TAI ns of the first image."""
        return _EPOCH_TAI_NS

    def brightest(self, limit: float) -> int:
        """Return how many of the catalogue's stars, which come brightest first, reach a limit."""
        return int(np.searchsorted(self.matcher.catalogue.magnitude, limit, side="right"))


@dataclass(frozen=True)
class MeasuredImages:
    """Images of known stars with their measured centroids row_px, col_px (K,)."""

    known: KnownImages
    row_px: Floats
    col_px: Floats

    def between(self, first: int, last: int) -> MeasuredImages:
        """Return images ``first`` to ``last`` - 1, numbered anew."""
        a, b = self.known.offsets[[first, last]]
        return MeasuredImages(self.known.between(first, last), self.row_px[a:b], self.col_px[a:b])

    def brighter(self, stars: int) -> MeasuredImages:
        """Return the images as a sensor takes them that sees the ``stars`` brightest alone."""
        return self._with_stars(self.known.star < stars)

    def at(self, images: Ints) -> MeasuredImages:
        """Return the images named by their places, rising, numbered anew."""
        found = self._with_stars(np.isin(self.known.image, images))
        image = np.searchsorted(images, found.known.image)
        return replace(found, known=replace(found.known, t_s=found.known.t_s[images], image=image))

    def _with_stars(self, kept: NDArray[np.bool_]) -> MeasuredImages:
        known = self.known
        names = ("image", "star", "s_i", "row_px", "col_px")
        seen = {name: getattr(known, name)[kept] for name in names}
        return MeasuredImages(replace(known, **seen), self.row_px[kept], self.col_px[kept])


def make_scene(config: SensorConfig, calibration: int, evaluation: int) -> Scene:
    """Set up the scene.

    Parameters
    ----------
    config : the sensor; its nominal camera is the true one
    calibration, evaluation : number of images to calibrate with, and to judge by

    Raises
    ------
    ConfigError
        When the sensor's camera model isn't the paper's.
    """
    if config.camera.model != _CAMERA:
        raise ConfigError(
            f"configuration {config.name!r}: camera.model is {config.camera.model!r}; the study "
            f"is of {_CAMERA!r}"
        )
    true, initial = (cameras_of(values, {}, config)[0] for values in ({}, INITIAL))
    config = _with_prior(config, true, initial)
    return Scene(
        matcher=matcher_of(config),
        true=true,
        initial=Calibration(SENSOR_ID, 1, initial, np.eye(3)),
        calibration=calibration,
        evaluation=evaluation,
    )


def _with_prior(config: SensorConfig, true: Camera, initial: Camera) -> SensorConfig:
    """Return the configuration for all groups; its prior covers the error of every initial value.

    The paper doesn't give its prior covariance.
    """
    scale = parameter_scale(config, true.parameter_names)
    sigma = float(np.abs((initial.parameters - true.parameters) / scale).max())
    changes = {
        "sequential": config.sequential.model_copy(update={"initial_sd_sigma": sigma}),
        "catalogue": config.catalogue.model_copy(
            update={"limiting_magnitude": max(LIMITS.values())}
        ),
    }
    return config.model_copy(update=changes)


def take_images(scene: Scene, rng: np.random.Generator) -> MeasuredImages:
    """Return the images of one run, with all stars that the deepest group sees."""
    count = scene.calibration + scene.evaluation
    # Normal quaternions give uniform attitudes.
    c_di = Rotation.from_quat(rng.normal(size=(count, 4))).as_matrix()
    known = known_images(
        scene.true, c_di, np.arange(count) / _IMAGES_PER_S, Sky(scene.matcher.catalogue)
    )
    error = scene.config.noise.sd_px * rng.normal(size=(2, len(known.star)))
    return MeasuredImages(known, known.row_px + error[0], known.col_px + error[1])
