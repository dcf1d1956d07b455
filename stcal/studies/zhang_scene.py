"""The scene of the study ``zhang``: orbit, sensor, cameras, and the stars of every image.

As in the paper the body is in the orbital frame, here with x along the track and z to the zenith,
and the sensor is mounted by matrix (52): it looks to the zenith, and stars cross the field once in
about four minutes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.calibration import Calibration
from stcal.cameras import CAMERAS, Camera
from stcal.config import SensorConfig
from stcal.errors import ConfigError
from stcal.matching import Matcher
from stcal.pipeline.parameters import parameter_scale
from stcal.simulate import Scenario
from stcal.simulate.orbit import local_frame, orbit_from
from stcal.simulate.sky import Sky
from stcal.studies.given import KnownImages, known_images
from stcal.studies.scenarios import matcher_of
from stcal.studies.zhang_paper import NAMES, true_mounting

Floats = NDArray[np.float64]

_MODEL = "pixel-radial"
# True values: those that the published averages lie at.  Initial values: a principal point taken at
# the detector's middle, and a ground calibration with half a per mille of focal length and a good
# tenth of the distortion wrong.
_TRUE = (500.0, 530.0, 74e-3, 2e-8, -1e-14)
_INITIAL = (511.5, 511.5, 73.95e-3, 1.7e-8, -0.7e-14)
# The paper does not give the prior: 3 sigma of the configuration cover the initial errors.
_PRIOR_SIGMA = 3.0
IMAGES_PER_S = 1.0
# Where on the orbit it begins: the 20 stars that the sky has in such a field on average.
_START_S = 1500.0
# Axes of B in the local frame (x radial outwards, y along the track, z the orbit's normal).
_C_LB = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True)
class Scene:
    """What all runs share.

    Attributes
    ----------
    matcher : the catalogue, and the sensor's configuration with this study's prior
    epoch : TAI ns of the first image
    true : the camera that takes the images
    initial : where every filter starts
    c_sb, c_bi : (3, 3) mounting, (F, 3, 3) attitude of the body at each image
    images : those of the calibration, then those of the alignment
    calibration_images : how many are of the calibration
    """

    matcher: Matcher
    epoch: int
    true: Camera
    initial: Calibration
    c_sb: Floats
    c_bi: Floats
    images: KnownImages
    calibration_images: int

    @property
    def config(self) -> SensorConfig:
        """The sensor's configuration."""
        return self.matcher.config

    @property
    def scale(self) -> Floats:
        """Sigma (P,) of each parameter."""
        return parameter_scale(self.config, NAMES)

    @property
    def prior_sd(self) -> Floats:
        """Sd (P,) of what the filters know of each parameter before the first image."""
        return self.config.sequential.initial_sd_sigma * self.scale

    @property
    def calibration(self) -> KnownImages:
        """The images of the first stage."""
        return self.images.between(0, self.calibration_images)

    @property
    def alignment(self) -> KnownImages:
        """The images of the second stage."""
        return self.images.between(self.calibration_images, self.images.n_images)


def make_scene(scenario: Scenario, calibration_s: float, alignment_s: float) -> Scene:
    """Set up the scene.

    Parameters
    ----------
    scenario : its orbit, epoch and sensor are used
    calibration_s, alignment_s : length of the two stages, one after the other

    Raises
    ------
    ConfigError
        When the sensor has another camera model, or sees too few stars.
    """
    config = _with_prior(scenario.sensor)
    if config.camera.model != _MODEL:
        raise ConfigError(f"{config.name!r}: the study needs camera model {_MODEL!r}")
    matcher = matcher_of(config)
    initial, true = (_camera(config, values) for values in (_INITIAL, _TRUE))
    first, second = (round(s * IMAGES_PER_S) + 1 for s in (calibration_s, alignment_s))
    t_s = np.arange(first + second) / IMAGES_PER_S
    c_il, _ = local_frame(orbit_from(scenario.orbit, scenario.epoch_tai_ns), _START_S + t_s)
    c_bi = np.swapaxes(c_il.as_matrix() @ _C_LB, 1, 2)
    c_sb = true_mounting()
    images = known_images(true, c_sb @ c_bi, t_s, Sky(matcher.catalogue))
    _check_stars(images, config)
    return Scene(
        matcher=matcher,
        epoch=scenario.epoch_tai_ns + round(_START_S * 1e9),
        true=true,
        # D is S: what the camera's own alignment lacks, the mounting takes up.
        initial=Calibration(scenario.sensor_id, 1, initial, np.eye(3)),
        c_sb=c_sb,
        c_bi=c_bi,
        images=images,
        calibration_images=first,
    )


def _with_prior(config: SensorConfig) -> SensorConfig:
    sequential = config.sequential.model_copy(update={"initial_sd_sigma": _PRIOR_SIGMA})
    return config.model_copy(update={"sequential": sequential})


def _camera(config: SensorConfig, values: tuple[float, ...]) -> Camera:
    detector = config.detector
    model = CAMERAS[_MODEL]
    return Camera(model, detector.rows, detector.cols, detector.pixel_size_m, np.array(values))


def _check_stars(images: KnownImages, config: SensorConfig) -> None:
    fewest = int(np.bincount(images.image, minlength=images.n_images).min())
    needed = config.fit.minimum_stars_per_exposure
    if fewest < needed:
        raise ConfigError(
            f"{config.name!r}: an image has {fewest} stars to limiting magnitude "
            f"{config.catalogue.limiting_magnitude:g}, at least {needed} needed"
        )
