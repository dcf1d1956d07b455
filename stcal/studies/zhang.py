"""Study ``zhang``: the two-stage calibration of Zhang et al. 2024 on simulated images.

First stage: filters that estimate the camera, the paper's and others, on the same noisy centroids
of known stars.  Second stage: the mounting in the body, with the cameras of the first.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stcal.execution import OrderedMap, serial
from stcal.pipeline.describe import header
from stcal.pipeline.numbers import numbers
from stcal.report.document import ZHANG_SCHEMA
from stcal.simulate import Scenario
from stcal.studies.zhang_alignment import align_all, alignment_part
from stcal.studies.zhang_calibration import bounds, convergence, errors_at
from stcal.studies.zhang_findings import findings
from stcal.studies.zhang_image import mean_square, residual_distortion, spot
from stcal.studies.zhang_levels import low_frequency, noise_levels
from stcal.studies.zhang_noise import CentroidNoise
from stcal.studies.zhang_paper import LENGTH_S, NAMES, published
from stcal.studies.zhang_runs import FILTERS, OURS, PAPER, Draws, MonteCarlo, calibrate
from stcal.studies.zhang_scene import IMAGES_PER_S, Scene, make_scene

# The second stage needs less time than the first.
_ALIGNMENT_S = 300.0


def run_study(
    scenario: Scenario,
    runs: int,
    seed: int,
    mapper: OrderedMap = serial,
    length_s: float = LENGTH_S,
    alignment_s: float = _ALIGNMENT_S,
) -> dict[str, Any]:
    """Run the study and return its document, schema ``stcal.study.zhang/1``.

    Parameters
    ----------
    scenario : its orbit, epoch and sensor are used
    runs : how often, with other noise on the same images
    seed : of the noise; the same seed gives the same numbers
    mapper : ordered map over the runs
    length_s, alignment_s : length of the two stages
    """
    scene = make_scene(scenario, length_s, alignment_s)
    monte_carlo = MonteCarlo(runs, Draws(seed), mapper)
    images, noise = scene.calibration, CentroidNoise()
    tracks = calibrate(scene, images, noise, tuple(FILTERS), monte_carlo)
    bound = bounds(scene, images, noise.white)
    errors = errors_at(images.t_s, tracks, bound)
    document = {
        **header(ZHANG_SCHEMA, scenario.sensor_id),
        "seed": seed,
        "runs": runs,
        "settings": _settings(scene, scenario),
        "paper": published(),
        "convergence": convergence(scene, images.t_s, tracks, bound),
        "errors": errors,
        "mean_square": mean_square(scene, images.t_s, tracks, bound),
        "distortion": {
            name: residual_distortion(scene, images.t_s, tracks[name]) for name in (PAPER, OURS)
        },
        "spot": spot(scene, tracks),
        "noise_levels": noise_levels(scene, monte_carlo, errors),
        "low_frequency": low_frequency(scene, monte_carlo),
        "alignment": alignment_part(scene, align_all(scene, tracks, monte_carlo)),
    }
    return document | {"findings": findings(document)}


def _settings(scene: Scene, scenario: Scenario) -> dict[str, Any]:
    """Return what the numbers depend on."""
    stars = np.bincount(scene.calibration.image, minlength=scene.calibration.n_images)
    columns = {
        "true": scene.true.parameters,
        "initial": scene.initial.camera.parameters,
        "prior_sd": scene.prior_sd,
    }
    return {
        "altitude_km": scenario.orbit.altitude_km,
        "inclination_deg": scenario.orbit.inclination_deg,
        "rows": scene.true.rows,
        "cols": scene.true.cols,
        "pixel_size_m": scene.true.pixel_size_m,
        "limiting_magnitude": scene.config.catalogue.limiting_magnitude,
        "images_per_s": IMAGES_PER_S,
        "calibration_images": scene.calibration_images,
        "alignment_images": scene.alignment.n_images,
        "stars_per_image": {
            "mean": float(stars.mean()), "least": int(stars.min()), "most": int(stars.max()),
        },
        "parameters": {
            key: dict(zip(NAMES, numbers(values), strict=True)) for key, values in columns.items()
        },
    }  # fmt: skip
