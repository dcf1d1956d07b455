"""A residual bound to matched stars: everything that the camera doesn't change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.residuals.selection import StarSelection

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class BoundResidual:
    """Residuals of a selection with their whitening.

    Attributes
    ----------
    selection : the stars
    kind : the residual's name
    ints, floats : what its kernels have made of the stars (``contract_kernels``)
    """

    selection: StarSelection
    kind: str
    ints: Ints
    floats: Floats

    @property
    def dependent(self) -> int:
        """Number of rows that carry nothing new and drop out."""
        return int(self.ints[1])

    @property
    def rows(self) -> int:
        """Number of independent residuals."""
        return int(self.ints[0] - self.ints[1])

    def linearise(self, camera: Camera) -> Floats:
        """Return whitened rows [H | residual] (A, P + 1), parameters in their own units.

        The centroid noise is constant in pixels, so in rad it falls as the focal length grows.
        With R held fixed the fit would pay for noise with a longer focal length: a bias that grows
        with the noise and, in sd, with the square root of the number of frames.  So residuals are
        divided by how their sd changes with the parameters, and that division is differentiated.
        """
        from stcal.residuals.kernels import RESIDUAL_KERNELS

        s_d, by_parameter, _ = camera.jacobian(self.selection.row_px, self.selection.col_px)
        out = np.empty((int(self.ints[0]), by_parameter.shape[2] + 1))
        rows = RESIDUAL_KERNELS[self.kind].rows
        rows(self.ints, self.floats, camera.parameters, s_d, by_parameter, out)
        return out


def bound_arrays(
    kind: str, selection: StarSelection, camera: Camera, options: Floats
) -> tuple[Ints, Floats]:
    """Return what a residual's kernel makes of the stars, the noise in rad being the camera's."""
    from stcal.residuals.kernels import RESIDUAL_KERNELS

    row, col = selection.row_px, selection.col_px
    sd = selection.sd_px * camera.noise_scale(row, col)
    slopes = camera.noise_scale_slopes(row, col)
    bind = RESIDUAL_KERNELS[kind].bind
    ints, floats = bind(
        selection.offsets, np.ascontiguousarray(selection.s_i), sd, slopes, camera.parameters,
        options,
    )  # fmt: skip
    return ints, floats
