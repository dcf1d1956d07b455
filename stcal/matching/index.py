"""Sky index of a catalogue: a table of star pairs sorted by separation, and a map of the sky.

Both are built at one epoch (proper motion applied), so that fast stars are found where they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from stcal.catalog.catalogue import StarCatalogue
from stcal.errors import InputError

Floats = NDArray[np.float64]

# The product of two star numbers fits in 32 bits.
_MOST_STARS = 65_536
_LATTICE = np.linspace(-1.0, 1.0, 5)
_FINEST_CELL_RAD = np.radians(1.0)


@dataclass(frozen=True)
class SkyIndex:
    """Arrays that the identification kernels read.

    Attributes
    ----------
    star : (C, 8) direction (3) and motion (3) of the catalogue at J2000.0, parallax [rad], for
        apparent places; half the distance to the nearest other star [rad]
    direction : (C, 3) directions at the index's epoch
    pair_angle, pair : (P,), (P, 2) separation [rad] in rising order and the two stars
    pair_start, pair_bin_rad : offsets of equal bins of separation into the pair table
    cell_start, cell_star, cells : cube map with ``cells`` cells along an edge of each face; every
        star stands in each cell that it is within ``radius_rad`` of, so a look-up reads one cell
    density_per_sr : mean density of the catalogue
    """

    star: Floats
    direction: Floats
    pair_angle: NDArray[np.float32]
    pair: NDArray[np.int32]
    pair_start: NDArray[np.int32]
    pair_bin_rad: float
    cell_start: NDArray[np.int32]
    cell_star: NDArray[np.int32]
    cells: int
    radius_rad: float
    density_per_sr: float


def build_index(
    catalogue: StarCatalogue,
    years: float,
    pair_limit_rad: float,
    radius_rad: float,
    seed_magnitude: float = np.inf,
) -> SkyIndex:
    """Index a selected catalogue at ``years`` Julian years after J2000.0.

    ``radius_rad`` is the largest distance at which a look-up must find a star; pairs are made of
    stars up to ``seed_magnitude``.
    """
    at_epoch = catalogue.direction + years * catalogue.motion
    at_epoch /= np.linalg.norm(at_epoch, axis=1, keepdims=True)
    angle, pair, start, width = _pair_table(
        at_epoch, np.flatnonzero(catalogue.magnitude <= seed_magnitude), pair_limit_rad
    )
    cells = max(1, int((np.pi / 2) / max(_FINEST_CELL_RAD, 3.0 * radius_rad)))
    cell_start, cell_star = _cube_map(at_epoch, radius_rad, cells)
    columns = (catalogue.direction, catalogue.motion, catalogue.parallax, _half_gap(at_epoch))
    return SkyIndex(
        star=np.column_stack(columns),
        direction=at_epoch,
        pair_angle=angle,
        pair=pair,
        pair_start=start,
        pair_bin_rad=width,
        cell_start=cell_start,
        cell_star=cell_star,
        cells=cells,
        radius_rad=radius_rad,
        density_per_sr=len(at_epoch) / (4.0 * np.pi),
    )


def _half_gap(direction: Floats) -> Floats:
    """Return half the distance (C,) from each star to the nearest other."""
    if len(direction) < 2:
        return np.ones(len(direction))
    distance = np.asarray(cKDTree(direction).query(direction, k=2)[0])
    return np.asarray(0.5 * distance[:, 1])


def _pair_table(
    direction: Floats, seeds: NDArray[np.int64], limit_rad: float
) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.int32], float]:
    if len(direction) >= _MOST_STARS:
        raise InputError(
            f"{len(direction)} catalogue stars within the limiting magnitude, at most "
            f"{_MOST_STARS} can be indexed"
        )
    chord = 2.0 * np.sin(0.5 * min(limit_rad, np.pi))
    pairs = seeds[cKDTree(direction[seeds]).query_pairs(chord, output_type="ndarray")]
    difference = direction[pairs[:, 0]] - direction[pairs[:, 1]]
    length = np.sqrt(np.einsum("pi,pi->p", difference, difference))
    angle = (2.0 * np.arcsin(np.minimum(0.5 * length, 1.0))).astype(np.float32)
    # Sorted by angle (a positive float's bits rise with it), ties by the stars, so that the table
    # is the same whatever the tree's order.
    stars = len(direction)
    names = pairs[:, 0] * stars + pairs[:, 1]
    key = np.sort((angle.view(np.int32).astype(np.int64) << 32) | names)
    angle = (key >> 32).astype(np.int32).view(np.float32)
    sorted_pairs = np.stack(np.divmod(key & 0xFFFFFFFF, stars), axis=1).astype(np.int32)
    bins = max(1, len(angle) // 4)
    width = float(limit_rad / bins)
    edges = np.arange(bins + 2) * width
    start = np.searchsorted(angle, edges.astype(np.float32)).astype(np.int32)
    return angle, sorted_pairs, start, width


def cube_cell(direction: Floats, cells: int) -> NDArray[np.int64]:
    """Return the cell number (S,) of directions (S, 3) in the cube map."""
    axis = np.argmax(np.abs(direction), axis=1)
    rows = np.arange(len(direction))
    major = direction[rows, axis]
    half = 0.5 * cells
    scale = half / np.abs(major)
    i = (direction[rows, (axis + 1) % 3] * scale + half).astype(np.int64)
    j = (direction[rows, (axis + 2) % 3] * scale + half).astype(np.int64)
    i, j = np.minimum(i, cells - 1), np.minimum(j, cells - 1)
    face = 2 * axis + (major < 0)
    return np.asarray((face * cells + i) * cells + j)


def _cube_map(
    direction: Floats, radius_rad: float, cells: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """List each star in every cell that its disc of ``radius_rad`` reaches.

    A lattice over the square around the disc, finer than a cell, meets every such cell.
    """
    pole = np.where(np.abs(direction[:, 2:3]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    east = np.cross(pole, direction)
    east /= np.linalg.norm(east, axis=1, keepdims=True)
    north = np.cross(direction, east)
    du, dv = (g.ravel() * 1.05 * radius_rad for g in np.meshgrid(_LATTICE, _LATTICE))
    around = (
        direction[:, None] + du[:, None] * east[:, None] + dv[:, None] * north[:, None]
    ).reshape(-1, 3)
    star = np.repeat(np.arange(len(direction)), len(du))
    entries = np.unique(cube_cell(around, cells) * len(direction) + star)
    cell, star = np.divmod(entries, len(direction))
    start = np.searchsorted(cell, np.arange(6 * cells * cells + 1))
    return start.astype(np.int32), star.astype(np.int32)
