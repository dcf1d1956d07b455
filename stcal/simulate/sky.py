"""Which catalogue stars lie in the field of each exposure, and their apparent places."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from stcal.catalog.apparent import apparent_directions, observer_at
from stcal.catalog.catalogue import StarCatalogue, load, load_bundled, select
from stcal.config import CatalogueSection
from stcal.constants import ARCSEC

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Aberration and the proper motion of the fastest star over 60 years stay below this.
_MARGIN = 700.0 * ARCSEC


@dataclass(frozen=True)
class Sky:
    """The stars that can be detected at all, ready to be looked up by direction."""

    catalogue: StarCatalogue

    @cached_property
    def tree(self) -> cKDTree:
        """Tree over the catalogue's directions at J2000.0."""
        return cKDTree(self.catalogue.direction)


def full_catalogue(section: CatalogueSection) -> StarCatalogue:
    """Return the whole catalogue that the sensor's configuration names."""
    from pathlib import Path

    return load_bundled() if section.path is None else load(Path(section.path))


def make_sky(section: CatalogueSection, depth: float) -> Sky:
    """Return the sky to magnitude ``depth``, stars merged as the detector merges them.

    It goes deeper than what the matcher knows, so that unknown faint stars are detected too.
    """
    return Sky(select(full_catalogue(section), depth, section.merge_separation_arcsec))


def stars_in_cones(sky: Sky, axis: Floats, radius: float) -> tuple[Ints, Ints]:
    """Return (exposure (K,), star (K,)) of all stars within ``radius`` [rad] of axes (E, 3).

    Sorted by exposure, then star, so that random draws along the list are reproducible.
    """
    chord = 2.0 * np.sin(0.5 * min(radius + _MARGIN, np.pi))
    found = sky.tree.query_ball_point(axis, chord, return_sorted=True)
    count = np.fromiter(map(len, found), dtype=np.int64, count=len(found))
    exposure = np.repeat(np.arange(len(axis)), count)
    star = np.concatenate([np.empty(0, np.int64), *found]).astype(np.int64)
    return exposure, star


def places(
    sky: Sky, star: Ints, exposure: Ints, t_tai_ns: Ints, pos_km: Floats, vel_km_s: Floats
) -> Floats:
    """Return apparent directions (K, 3) in I, for exposures (E,) with the spacecraft's state."""
    observer = observer_at(t_tai_ns, pos_km, vel_km_s)
    return apparent_directions(sky.catalogue, star, exposure, observer)
