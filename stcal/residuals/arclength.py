"""Residual ``arclength``: separations of star pairs against the catalogue, Enright 2018 II-B."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.residuals.bound import BoundResidual, bind_blocks
from stcal.residuals.selection import StarSelection

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class BoundArclength(BoundResidual):
    """Arcs of a selection with their whitening; what the performance metrics are made of too."""

    @cached_property
    def pair_i(self) -> Ints:
        """(A,) the first star of each arc, an index into the selection."""
        return self._joined(0, [block.first for block in self.blocks])

    @cached_property
    def pair_j(self) -> Ints:
        """(A,) the second star of each arc."""
        return self._joined(1, [block.first for block in self.blocks])

    @cached_property
    def starts(self) -> Ints:
        """(A,) first row of the arc's exposure."""
        before = np.cumsum([0] + [int(block.ints[0]) for block in self.blocks])
        return self._joined(2, before[:-1].tolist())

    def _joined(self, which: int, shifts: list[int]) -> Ints:
        """Join one of the blocks' columns of numbers, which count from the block's own first."""
        from stcal.residuals.arclength_kernels import arc_stars

        parts = [
            arc_stars(block.ints)[which] + shift
            for block, shift in zip(self.blocks, shifts, strict=True)
        ]
        return np.concatenate([np.empty(0, np.int64), *parts])

    @cached_property
    def arc(self) -> Floats:
        """(A,) rad, separation by the catalogue, eq (10)."""
        return separations(self.selection.s_i[self.pair_i], self.selection.s_i[self.pair_j])

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
    blocks = bind_blocks("arclength", selection, camera, np.empty(0))
    return BoundArclength(selection, "arclength", blocks)
