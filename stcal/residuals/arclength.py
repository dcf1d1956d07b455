"""Residual ``arclength``: separations of star pairs against the catalogue, Enright 2018 II-B."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.residuals.bound import BoundResidual, bound_arrays
from stcal.residuals.selection import StarSelection

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class BoundArclength(BoundResidual):
    """Arcs of a selection with their whitening; what the performance metrics are made of too.

    Attributes
    ----------
    pair_i, pair_j : (A,) the two stars of each arc, indices into the selection
    starts : (A,) first row of the arc's exposure
    arc : (A,) rad, separation by the catalogue, eq (10)
    """

    pair_i: Ints
    pair_j: Ints
    starts: Ints
    arc: Floats

    def departures(self, camera: Camera) -> Floats:
        """Return the arclength errors (A,) in rad, unweighted, eq (12)."""
        s_d = camera.directions(self.selection.row_px, self.selection.col_px)
        return separations(s_d[self.pair_i], s_d[self.pair_j]) - self.arc


def separations(a: Floats, b: Floats) -> Floats:
    """Return angles (K,) between unit vectors (K, 3); exact for short arcs, unlike the arccos."""
    return np.asarray(
        2.0 * np.arctan2(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1))
    )


def bind_arclength(selection: StarSelection, camera: Camera) -> BoundArclength:
    """Choose the 2 N - 3 arcs of each exposure and factor their covariance.

    The noise in rad is that of the camera given, and how it changes with the parameters.
    """
    from stcal.residuals.arclength_kernels import arc_stars

    ints, floats = bound_arrays("arclength", selection, camera, np.empty(0))
    pair_i, pair_j, starts = arc_stars(ints)
    arc = separations(selection.s_i[pair_i], selection.s_i[pair_j])
    return BoundArclength(selection, "arclength", ints, floats, pair_i, pair_j, starts, arc)
