"""Small catalogues for tests."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stcal.catalog.catalogue import StarCatalogue
from stcal.constants import ARCSEC, DEG

Floats = NDArray[np.float64]


def stars_near(
    ra_deg: float,
    dec_deg: float,
    east_arcsec: list[float],
    north_arcsec: list[float],
    magnitude: list[float],
    **columns: object,
) -> StarCatalogue:
    """Stars at small offsets from a place; HIP 1, 2, ... in the order given."""
    east, north = frame(ra_deg, dec_deg)
    centre = np.cross(east, north)
    direction = (
        centre + np.outer(east_arcsec, east) * ARCSEC + np.outer(north_arcsec, north) * ARCSEC
    )
    return stars(direction, magnitude=np.asarray(magnitude, dtype=float), **columns)


def frame(ra_deg: float, dec_deg: float) -> tuple[Floats, Floats]:
    """Unit vectors to the east and to the north."""
    ra, dec = ra_deg * DEG, dec_deg * DEG
    east = np.array([-np.sin(ra), np.cos(ra), 0.0])
    north = np.array([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)])
    return east, north


def stars(direction: Floats, **columns: object) -> StarCatalogue:
    """Stars in the directions (C, 3), normalised, columns by name, dull defaults else."""
    n = len(direction)
    values: dict[str, object] = {
        "star_id": np.arange(1, n + 1),
        "direction": direction / np.linalg.norm(direction, axis=1, keepdims=True),
        "motion": np.zeros((n, 3)),
        "parallax": np.zeros(n),
        "magnitude": np.full(n, 5.0),
        "colour": np.full(n, np.nan),
        "multiple": np.zeros(n, dtype=bool),
        "merged": np.zeros(n, dtype=bool),
        "source": np.full(n, "T"),
    }
    return StarCatalogue(**(values | columns))  # type: ignore[arg-type]


def random_directions(rng: np.random.Generator, n: int) -> Floats:
    """Directions (n, 3) evenly over the sky."""
    vectors = rng.normal(size=(n, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
