"""One sensor for each camera model: its detector, nominal parameters, and their spread."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stcal.cameras import CAMERAS, Camera


@dataclass(frozen=True)
class Case:
    """A sensor, and ``effects``: a departure in sigma in which every parameter plays a part."""

    model: str
    rows: int
    cols: int
    pixel_size_m: float
    nominal: tuple[float, ...]
    sigma: tuple[float, ...]
    effects: tuple[float, ...]

    def camera(self, departure: ArrayLike | None = None) -> Camera:
        """The camera at a departure (P,) from the nominal one, in sigma."""
        z = np.asarray(self.effects if departure is None else departure)
        x = np.array(self.nominal) + np.array(self.sigma) * z
        return Camera(CAMERAS[self.model], self.rows, self.cols, self.pixel_size_m, x)

    def centroids(self, count: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """Random centroids (m, n) on the detector."""
        rng = np.random.default_rng(seed)
        m, n = rng.uniform(-0.5, 0.5, (2, count)) * [[self.rows], [self.cols]]
        return m + 0.5 * (self.rows - 1), n + 0.5 * (self.cols - 1)


_LISTED = (
    Case(
        "wang", 1944, 2592, 2.2e-6,
        nominal=(0.016, 972.0, 1296.0, 0.0, 0.0, 0.0, 0.0, 1.0),
        sigma=(8e-6, 30.0, 30.0, 1e8, 1e3, 0.01, 0.01, 2e-4),
        effects=(-8.0, 0.3, -1.5, 1.4, -1.2, 5.0, 2.0, 4.0),
    ),
    Case(
        "pinhole-radial", 1080, 1920, 2.9e-6,
        nominal=(1.0, 0.016, 970.0, 550.0, -0.5, 0.5),
        sigma=(2e-4, 8e-6, 30.0, 30.0, 0.2, 2.0),
        effects=(4.0, -8.0, -1.5, 0.3, -2.0, 1.4),
    ),
    Case(
        "pixel-radial", 1024, 1024, 18e-6,
        nominal=(511.5, 511.5, 0.074, 2e-8, -1e-14),
        sigma=(30.0, 30.0, 4e-5, 1e-8, 1e-14),
        effects=(0.3, -1.5, -8.0, 2.0, -1.2),
    ),
)  # fmt: skip
CASES = {case.model: case for case in _LISTED}
