"""From stars in the field to detections: limits, centroid noise, gaps, false stars, outliers."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.simulate.scenario import Scenario
from stcal.simulate.sections import Detection, Intensity, TrueNoise

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

# Beyond this many roll-off widths a star isn't detected: probability 1e-7.
_WIDTHS = 16.0
# False stars are as bright as the faintest real ones: magnitudes above the limit.
_FALSE_MAG_SCALE = 0.5
# Telemetry carries centroids to 1e-3 px and intensity to 0.1 counts.
CENTROID_DECIMALS, _COUNT_DECIMALS = 3, 1


@dataclass(frozen=True)
class Images:
    """Where stars truly fall on the detector: columns (K,), ``star`` a row of the sky."""

    exposure: Ints
    star: Ints
    magnitude: Floats
    row_px: Floats
    col_px: Floats


@dataclass(frozen=True)
class Detections:
    """Detections of some exposures as columns (S,), sorted by exposure, bright stars first.

    ``star`` is the row in the sky's catalogue, -1 for a false star; ``sd_px`` the centroid noise
    per axis that was drawn from, NaN for a false star; ``outlier`` marks gross centroid errors.
    """

    exposure: Ints
    star: Ints
    row_px: Floats
    col_px: Floats
    intensity: Floats
    sd_px: Floats
    outlier: Bools

    def take(self, which: Ints | Bools) -> Detections:
        """Return the selected detections (mask, or indices in the wanted order)."""
        return Detections(*(getattr(self, f.name)[which] for f in fields(self)))


def faintest(detection: Detection) -> float:
    """Return the magnitude beyond which no star is ever detected."""
    return detection.limiting_magnitude + _WIDTHS * detection.width_mag


def draw_detected(
    magnitude: Floats, limit: Floats, detection: Detection, rng: np.random.Generator
) -> Bools:
    """Draw which stars (K,) are detected at their exposure's limit (K,): a logistic roll-off."""
    with np.errstate(over="ignore"):
        probability = 1.0 / (1.0 + np.exp((magnitude - limit) / detection.width_mag))
    probability *= 1.0 - detection.missing_probability
    return np.asarray(rng.random(len(magnitude)) < probability)


def image(camera: Camera, s_d: Floats) -> tuple[Floats, Floats, Bools]:
    """Return (row, col, on the detector) of directions (K, 3).

    A direction counts only when its centroid leads back to it: outside the detector the inverse
    of the map may find the image of something else.  The camera's parameters may be (P, K).
    """
    m, n = camera.project(s_d)
    inside = np.isfinite(m) & np.isfinite(n) & camera.contains(m, n)
    back = camera.directions(np.where(inside, m, 0.0), np.where(inside, n, 0.0))
    return m, n, inside & (np.linalg.norm(back - s_d, axis=1) < 1e-9)


def noise_sd(noise: TrueNoise, intensity: Floats) -> Floats:
    """Return the centroid noise (S,) per axis: a floor, and photon noise of faint stars."""
    photon = noise.photon_sd_px**2 * noise.reference_intensity / np.maximum(intensity, 1e-9)
    return np.sqrt(noise.sd_px**2 + photon)


def detect(
    images: Images,
    n_exposures: int,
    camera: Camera,
    scenario: Scenario,
    rng: np.random.Generator,
) -> Detections:
    """Return the detections of true images: noise, outliers and false stars added.

    What noise moves off the detector is lost; each exposure keeps its ``maximum_stars`` brightest.
    """
    detection, count = scenario.detection, len(images.star)
    intensity = _counts(images.magnitude, scenario.intensity, rng)
    sd = noise_sd(scenario.noise, intensity)
    outlier = rng.random(count) < detection.outlier_probability
    error = rng.normal(size=(2, count)) * sd
    error += rng.normal(size=(2, count)) * np.where(outlier, detection.outlier_sd_px, 0.0)
    row, col = images.row_px + error[0], images.col_px + error[1]
    real = Detections(images.exposure, images.star, row, col, intensity, sd, outlier)
    false = _false_stars(n_exposures, camera, scenario, rng)
    joined = Detections(
        *(np.concatenate([getattr(real, f.name), getattr(false, f.name)]) for f in fields(real))
    )
    inside = camera.contains(joined.row_px, joined.col_px)
    return _brightest(joined.take(inside), n_exposures, detection.maximum_stars)


def _counts(magnitude: Floats, intensity: Intensity, rng: np.random.Generator) -> Floats:
    scattered = magnitude + intensity.scatter_mag * rng.normal(size=len(magnitude))
    counts = 10.0 ** (0.4 * (intensity.zero_point_mag - scattered))
    return np.round(counts, _COUNT_DECIMALS)


def _false_stars(
    n_exposures: int, camera: Camera, scenario: Scenario, rng: np.random.Generator
) -> Detections:
    """Return Poisson many false stars per exposure, uniform over the detector."""
    detection = scenario.detection
    count = rng.poisson(detection.false_stars_per_exposure, n_exposures)
    total = int(count.sum())
    magnitude = detection.limiting_magnitude - rng.exponential(_FALSE_MAG_SCALE, total)
    return Detections(
        exposure=np.repeat(np.arange(n_exposures), count),
        star=np.full(total, -1, dtype=np.int64),
        row_px=rng.uniform(-0.5, camera.rows - 0.5, total),
        col_px=rng.uniform(-0.5, camera.cols - 0.5, total),
        intensity=_counts(magnitude, scenario.intensity, rng),
        sd_px=np.full(total, np.nan),
        outlier=np.zeros(total, dtype=bool),
    )


def _brightest(found: Detections, n_exposures: int, most: int) -> Detections:
    """Sort by exposure, then brightness, and cut each exposure at ``most``."""
    ordered = found.take(np.lexsort((-found.intensity, found.exposure)))
    first = np.searchsorted(ordered.exposure, np.arange(n_exposures))
    rank = np.arange(len(ordered.exposure)) - first[ordered.exposure]
    kept = ordered.take(rank < most)
    rounded = (np.round(kept.row_px, CENTROID_DECIMALS), np.round(kept.col_px, CENTROID_DECIMALS))
    return Detections(kept.exposure, kept.star, *rounded, kept.intensity, kept.sd_px, kept.outlier)
