"""Residual ``arclength``: separations of star pairs against the catalogue, Enright 2018 II-B."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.residuals.selection import StarSelection

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class BoundArclength:
    """Arcs of a selection with their whitening; everything that the camera doesn't change.

    Attributes
    ----------
    selection : the stars
    pair_i, pair_j : (A,) the two stars of each arc, indices into the selection
    arc : (A,) rad, separation by the catalogue, eq (10)
    lower : (A, 5) banded Cholesky factor of R
    starts : (A,) first row of the arc's exposure
    reference : (P,) parameters at which R was made
    slope : (A, P) derivative of the logarithm of each arc's sd by the parameters
    dependent : number of arcs that carried nothing new and were dropped
    """

    selection: StarSelection
    pair_i: Ints
    pair_j: Ints
    arc: Floats
    lower: Floats
    starts: Ints
    reference: Floats
    slope: Floats
    dependent: int

    @property
    def rows(self) -> int:
        """Number of independent residuals."""
        return len(self.pair_i) - self.dependent

    def linearise(self, camera: Camera) -> Floats:
        """Return whitened rows [H | residual] (A, P + 1), parameters in their own units.

        The centroid noise is constant in pixels, so in rad it falls as the focal length grows.
        With R held fixed the fit would pay for noise with a longer focal length: a bias that grows
        with the noise and, in sd, with the square root of the number of frames.  So residuals are
        divided by how their sd changes with the parameters, and that division is differentiated.
        """
        from stcal.residuals.arclength_kernels import whiten

        s_d, by_parameter, _ = camera.jacobian(self.selection.row_px, self.selection.col_px)
        out = np.empty((len(self.pair_i), by_parameter.shape[2] + 1))
        scale = np.exp(self.slope @ (camera.parameters - self.reference))
        whiten(
            self.pair_i, self.pair_j, self.lower, self.starts, self.arc, scale, self.slope,
            s_d, by_parameter, out,
        )  # fmt: skip
        return out

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
    from stcal.residuals.arclength_kernels import BAND, factor, order_stars

    counts = np.diff(selection.offsets)
    arcs = np.maximum(2 * counts - 3, 0)
    order = np.empty(len(selection.star), np.int64)
    order_stars(selection.offsets, selection.s_i, order)
    sd = selection.sd_px * camera.noise_scale(selection.row_px, selection.col_px)
    pair_i, pair_j = (np.empty(int(arcs.sum()), np.int64) for _ in range(2))
    lower = np.zeros((len(pair_i), BAND + 1))
    dependent = factor(selection.offsets, selection.s_i, order, sd, pair_i, pair_j, lower)
    starts = np.repeat(np.cumsum(arcs) - arcs, arcs)
    arc = separations(selection.s_i[pair_i], selection.s_i[pair_j])
    slope = _arc_slopes(selection, camera, sd, pair_i, pair_j)
    return BoundArclength(
        selection, pair_i, pair_j, arc, lower, starts, camera.parameters, slope, int(dependent)
    )


def _arc_slopes(
    selection: StarSelection, camera: Camera, sd: Floats, pair_i: Ints, pair_j: Ints
) -> Floats:
    """Return (A, P): the arc's log-sd slope is the mean of its stars', weighted by variance."""
    slopes = camera.noise_scale_slopes(selection.row_px, selection.col_px)
    variance = sd * sd
    weight = (variance[pair_i] / (variance[pair_i] + variance[pair_j]))[:, None]
    return np.asarray(weight * slopes[pair_i] + (1.0 - weight) * slopes[pair_j])
