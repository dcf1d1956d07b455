"""Star pairs by the 2 N - 3 rule: separations against the catalogue, Enright 2018 II-B."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.residuals.selection import StarSelection

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Arcs:
    """Arcs of a selection, exposure by exposure; what the performance metrics are made of.

    Attributes
    ----------
    selection : the stars
    pair_i, pair_j : (A,) the two stars of each arc, indices into the selection
    starts : (A,) first arc of the arc's exposure
    """

    selection: StarSelection
    pair_i: Ints
    pair_j: Ints
    starts: Ints

    def __len__(self) -> int:
        """Return the number of arcs A."""
        return len(self.pair_i)

    def departures(self, camera: Camera) -> Floats:
        """Return the arclength errors (A,) in rad, unweighted, eq (12)."""
        from stcal.residuals.arclength_kernels import arc_errors

        row_px, col_px, s_i, _ = self.selection.columns
        out = np.empty(len(self))
        arc_errors(self.pair_i, self.pair_j, camera.directions(row_px, col_px), s_i, out)
        return out


def choose_arcs(selection: StarSelection) -> Arcs:
    """Choose the 2 N - 3 arcs of each exposure; the arclength residual has the same."""
    from stcal.residuals.arclength_kernels import list_arcs
    from stcal.residuals.ordering_kernels import count_pairs

    count, s_i = count_pairs(selection.offsets), selection.columns[2]
    pair_i, pair_j, starts = (np.empty(count, np.int64) for _ in range(3))
    list_arcs(selection.offsets, s_i, pair_i, pair_j, starts)
    return Arcs(selection, pair_i, pair_j, starts)


def separations(a: Floats, b: Floats) -> Floats:
    """Return angles (K,) between unit vectors (K, 3); exact for short arcs, unlike the arccos."""
    return np.asarray(
        2.0 * np.arctan2(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1))
    )
