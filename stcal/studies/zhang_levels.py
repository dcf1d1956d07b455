"""How the errors after 300 s depend on the noise: Figure 11 of Zhang et al. 2024, and its LFE."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from stcal.studies.given import KnownImages
from stcal.studies.zhang_calibration import bounds, errors_at, image_at
from stcal.studies.zhang_noise import CentroidNoise
from stcal.studies.zhang_paper import CALIBRATION_S, NOISE_SD_PX
from stcal.studies.zhang_runs import OURS, PAPER, MonteCarlo, calibrate
from stcal.studies.zhang_scene import Scene

# Figure 11 has levels up to a pixel; that of the paper's other tests is among them.
LEVELS_PX = (0.05, 0.1, NOISE_SD_PX, 0.5, 1.0)
LOW_FREQUENCY = {
    "common": CentroidNoise(common=0.2),
    "field": CentroidNoise(field=0.05),
    "both": CentroidNoise(common=0.2, field=0.05),
}
COMPARED = (PAPER, OURS)


def noise_levels(
    scene: Scene, monte_carlo: MonteCarlo, usual: dict[str, Any]
) -> list[dict[str, Any]]:
    """Return Figure 11: the errors at each level of white noise, which the filters know.

    ``usual`` are those at the paper's level, as :func:`errors_at` gives them.
    """
    others = [level for level in LEVELS_PX if level != NOISE_SD_PX]
    found = {level: _errors(scene, CentroidNoise(level), monte_carlo) for level in others}
    found[NOISE_SD_PX] = usual
    return [{"noise_px": level, **found[level]} for level in LEVELS_PX]


def low_frequency(scene: Scene, monte_carlo: MonteCarlo) -> list[dict[str, Any]]:
    """Return the errors with low-frequency noise, of which the filters know nothing."""
    return [
        {"case": case, "noise": asdict(noise), **_errors(scene, noise, monte_carlo)}
        for case, noise in LOW_FREQUENCY.items()
    ]


def _errors(scene: Scene, noise: CentroidNoise, monte_carlo: MonteCarlo) -> dict[str, Any]:
    images = images_until_read(scene)
    tracks = calibrate(scene, images, noise, COMPARED, monte_carlo)
    return errors_at(images.t_s, tracks, bounds(scene, images, noise.white))


def images_until_read(scene: Scene) -> KnownImages:
    """Return the images up to the time at which errors are read."""
    images = scene.calibration
    return images.between(0, image_at(images.t_s, CALIBRATION_S) + 1)
