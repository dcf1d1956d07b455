"""Simulated exposures of the identification benchmark: a 15 x 20 deg field, V <= 5.8, 16 mm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from stcal.cameras import CAMERAS, Camera
from stcal.catalog.apparent import apparent_directions, observer_at
from stcal.catalog.catalogue import StarCatalogue
from stcal.frames import FrameBatch
from stcal.times import parse_utc

ROWS, COLS, PIXEL_M, FOCAL_M = 1944, 2592, 2.2e-6, 0.016


@dataclass(frozen=True)
class Scene:
    """What the images of a scene suffer from."""

    name: str
    noise_px: float
    missing: float = 0.0
    false_stars: int = 0
    focal_error: float = 0.0
    distortion_px: float = 0.0
    centre_px: float = 0.0


SCENES = (
    Scene("0.1 px", 0.1),
    Scene("0.2 px", 0.2),
    Scene("0.3 px", 0.3),
    Scene("0.2 px, 15 % missing, 2 false", 0.2, 0.15, 2),
    Scene("as before, f +0.3 %, 10 px distortion, 15 px centre", 0.2, 0.15, 2, 3e-3, 10.0, 15.0),
)


def nominal_camera() -> Camera:
    """Return the camera that the identification believes in."""
    x = np.array([FOCAL_M, 972.0, 1296.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    return Camera(CAMERAS["wang"], ROWS, COLS, PIXEL_M, x)


def true_camera(scene: Scene) -> Camera:
    """Return the camera that takes the scene's images."""
    corner = PIXEL_M * np.hypot(ROWS / 2, COLS / 2)
    x = nominal_camera().parameters.copy()
    x[0] *= 1.0 + scene.focal_error
    x[1:3] += scene.centre_px / np.sqrt(2.0)
    x[4] = scene.distortion_px * PIXEL_M / corner**3
    return nominal_camera().with_parameters(x)


@dataclass(frozen=True)
class Images:
    """Frames with one exposure each, the truth per detection (-1 = false) and per exposure."""

    frames: FrameBatch
    truth: np.ndarray
    c_di: np.ndarray


def make_images(scene: Scene, count: int, catalogue: StarCatalogue, seed: int) -> Images:
    """Simulate ``count`` exposures (exposure 0 of as many frames) in random attitudes."""
    rng = np.random.default_rng(seed)
    camera, c_di = true_camera(scene), Rotation.random(count, rng=rng).as_matrix()
    t = parse_utc("2025-01-01T00:00:00Z") + np.arange(count) * 10**9
    nothing = np.full((count, 3), np.nan)
    observer = observer_at(t, nothing, nothing)
    exposure, star = np.nonzero(c_di[:, 2] @ catalogue.direction.T > np.cos(np.radians(14.0)))
    s_d = np.einsum(
        "kij,kj->ki", c_di[exposure], apparent_directions(catalogue, star, exposure, observer)
    )
    m, n = camera.project(s_d)
    seen = np.isfinite(m) & camera.contains(m, n) & (rng.random(len(m)) >= scene.missing)
    exposure, star, m, n = exposure[seen], star[seen], m[seen], n[seen]
    magnitude = catalogue.magnitude[star] + rng.normal(0.0, 0.1, len(star))
    extra = np.repeat(np.arange(count), scene.false_stars)
    exposure = np.concatenate([exposure, extra])
    star = np.concatenate([star, np.full(len(extra), -1)])
    m = np.concatenate([m, rng.uniform(0, ROWS - 1, len(extra))])
    n = np.concatenate([n, rng.uniform(0, COLS - 1, len(extra))])
    magnitude = np.concatenate([magnitude, rng.uniform(3.0, 5.8, len(extra))])
    m, n = (v + rng.normal(0.0, scene.noise_px, len(v)) for v in (m, n))
    order = np.lexsort((rng.random(len(m)), exposure))
    counts = np.zeros((count, 2), int)
    counts[:, 0] = np.bincount(exposure, minlength=count)
    frames = FrameBatch(
        sensor_id="bench",
        frame_id=np.arange(count),
        t_tai_ns=t,
        best_exposure=np.full(count, -1, np.int8),
        q_si=np.full((count, 4), np.nan),
        rate_deg_s=nothing,
        temperature_c=np.full(count, np.nan),
        eclipse=np.zeros(count, bool),
        intrusion=np.zeros(count, bool),
        pos_km=nothing,
        vel_km_s=nothing,
        star_offsets=np.concatenate(([0], np.cumsum(counts.ravel()))),
        row_px=m[order],
        col_px=n[order],
        intensity=10.0 ** (-0.4 * (magnitude[order] - 6.0)) * 1000.0,
        star_id=np.zeros(len(m), np.int64),
    )
    return Images(frames, star[order], c_di)
