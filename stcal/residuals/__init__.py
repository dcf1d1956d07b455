"""Residuals by name: what a camera is fitted to.

A residual is bound to matched stars once (``bind``), and then linearised at any camera as often as
an estimator asks.  Its rows are whitened: independent, of unit variance under the noise model.
"""

from typing import Protocol

from stcal.cameras import Camera
from stcal.residuals.arclength import BoundArclength, bind_arclength
from stcal.residuals.selection import StarSelection, select_stars


class Bind(Protocol):
    """Bind a residual to matched stars; the camera gives the noise in rad."""

    def __call__(self, selection: StarSelection, camera: Camera) -> BoundArclength:
        """Return the bound residual."""


RESIDUALS: dict[str, Bind] = {"arclength": bind_arclength}

__all__ = ["RESIDUALS", "StarSelection", "select_stars"]
