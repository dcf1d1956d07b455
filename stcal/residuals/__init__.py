"""Residuals by name: what a camera is fitted to.

A residual is bound to matched stars once, and then linearised at any camera as often as an
estimator asks.  Its rows are whitened: independent, of unit variance under the noise model.  The
arithmetic is compiled (``kernels``), one source for batches and for filters frame by frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.errors import UsageError
from stcal.residuals.arclength import Arcs, choose_arcs
from stcal.residuals.bound import BoundResidual, bind_blocks
from stcal.residuals.selection import StarSelection, select_stars

Floats = NDArray[np.float64]

RESIDUALS: dict[str, str] = {
    "arclength": "separations of star pairs with their full covariance (Enright 2018)",
    "direction": "star directions with each exposure's attitude projected out",
    "singular-values": "singular values of star groups (Wu 2019)",
    "cosine": "inner products of star pairs, of one variance (Samaan 2001, Zhang 2024)",
}
GROUPS, VALUES = (1, 2, 3, 4), (1, 2, 3)


@dataclass(frozen=True)
class Residual:
    """A residual with its options.

    Attributes
    ----------
    name : a name in RESIDUALS
    groups, values : of ``singular-values``: Wu's model of star groups, and which of the three
        singular values are used
    """

    name: str = "arclength"
    groups: int = 4
    values: tuple[int, ...] = (2, 3)

    def check(self) -> None:
        """Refuse names and options that there aren't.

        Raises
        ------
        UsageError
        """
        if self.name not in RESIDUALS:
            raise UsageError(f"no residual {self.name!r}; known: {', '.join(RESIDUALS)}")
        if self.groups not in GROUPS:
            raise UsageError(f"groups {self.groups}: Wu's models are 1, 2, 3 and 4")
        if (
            not self.values
            or len(set(self.values)) != len(self.values)
            or set(self.values) - set(VALUES)
        ):
            raise UsageError(f"values {self.values}: give some of 1, 2 and 3, each once")

    @property
    def options(self) -> Floats:
        """What the compiled residual takes: (4,) for singular values, empty for the others."""
        if self.name != "singular-values":
            return np.empty(0)
        return np.array([self.groups, *(k in self.values for k in VALUES)], dtype=np.float64)

    def bind(self, selection: StarSelection, camera: Camera) -> BoundResidual:
        """Bind to matched stars; the camera gives the noise in rad."""
        blocks = bind_blocks(self.name, selection, camera, self.options)
        return BoundResidual(selection, self.name, blocks)


ARCLENGTH = Residual()

__all__ = [
    "ARCLENGTH",
    "RESIDUALS",
    "Arcs",
    "BoundResidual",
    "Residual",
    "StarSelection",
    "choose_arcs",
    "select_stars",
]
