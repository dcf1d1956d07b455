"""A residual bound to matched stars: everything that the camera doesn't change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.residuals.selection import StarSelection

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Exposures of a block: what is computed of their stars stays in the processor's cache.
_EXPOSURES = 256


@dataclass(frozen=True)
class Block:
    """A block of exposures, their stars being ``first`` to ``last`` - 1 of the selection.

    ``ints`` and ``floats`` are what the residual's kernels have made of them
    (``contract_kernels``); a star's number in them counts from the block's first.
    """

    first: int
    last: int
    ints: Ints
    floats: Floats


@dataclass(frozen=True)
class BoundResidual:
    """Residuals of a selection with their whitening.

    Attributes
    ----------
    selection : the stars
    kind : the residual's name
    blocks : exposures by the hundred
    """

    selection: StarSelection
    kind: str
    blocks: tuple[Block, ...]

    @property
    def size(self) -> int:
        """Number of residuals A, dependent ones included."""
        return sum(int(block.ints[0]) for block in self.blocks)

    @property
    def dependent(self) -> int:
        """Number of rows that carry nothing new and drop out."""
        return sum(int(block.ints[1]) for block in self.blocks)

    @property
    def rows(self) -> int:
        """Number of independent residuals."""
        return self.size - self.dependent

    def linearise(self, camera: Camera) -> Floats:
        """Return whitened rows [H | residual] (A, P + 1), parameters in their own units.

        The centroid noise is constant in pixels, so in rad it falls as the focal length grows.
        With R held fixed the fit would pay for noise with a longer focal length: a bias that grows
        with the noise and, in sd, with the square root of the number of frames.  So residuals are
        divided by how their sd changes with the parameters, and that division is differentiated.
        """
        from stcal.residuals.kernels import RESIDUAL_KERNELS

        s_d, by_parameter, _ = camera.jacobian(self.selection.row_px, self.selection.col_px)
        out = np.empty((self.size, by_parameter.shape[2] + 1))
        rows, start = RESIDUAL_KERNELS[self.kind].rows, 0
        for block in self.blocks:
            stars, stop = slice(block.first, block.last), start + int(block.ints[0])
            rows(
                block.ints, block.floats, camera.parameters, s_d[stars], by_parameter[stars],
                out[start:stop],
            )  # fmt: skip
            start = stop
        return out

    def reduce(self, camera: Camera, free: Ints) -> Floats:
        """Return the triangular factor (K + 1, K + 1) of [H | residual] for parameters ``free``.

        R^T R = [H | r]^T [H | r] of :meth:`linearise`, without its rows ever standing together;
        bitwise repeatable, since blocks are folded in their order.
        """
        from stcal.cameras.kernels import CAMERA_KERNELS
        from stcal.residuals.block_kernels import reduce_block
        from stcal.residuals.kernels import RESIDUAL_KERNELS

        columns = np.append(free, len(camera.parameters)).astype(np.int64)
        factor = np.zeros((len(columns), len(columns)))
        row_px, col_px, _, _ = self.selection.columns
        evaluate, rows = CAMERA_KERNELS[camera.model.name], RESIDUAL_KERNELS[self.kind].rows
        for block in self.blocks:
            stars = slice(block.first, block.last)
            reduce_block(
                evaluate, rows, block.ints, block.floats, camera.parameters, camera.pixel_size_m,
                row_px[stars], col_px[stars], columns, factor,
            )  # fmt: skip
        return factor


def bind_blocks(
    kind: str, selection: StarSelection, camera: Camera, options: Floats
) -> tuple[Block, ...]:
    """Bind a residual block by block, the noise in rad being the camera's."""
    from stcal.cameras.kernels import CAMERA_KERNELS
    from stcal.residuals.block_kernels import bind_block
    from stcal.residuals.kernels import RESIDUAL_KERNELS

    evaluate, bind = CAMERA_KERNELS[camera.model.name], RESIDUAL_KERNELS[kind].bind
    offsets, (row_px, col_px, s_i, sd_px) = selection.offsets, selection.columns
    blocks = []
    for exposure in range(0, selection.n_exposures, _EXPOSURES):
        mine = offsets[exposure : exposure + _EXPOSURES + 1]
        first, last = int(mine[0]), int(mine[-1])
        ints, floats = bind_block(
            evaluate, bind, camera.parameters, camera.pixel_size_m, camera.slope_table, camera.rows,
            camera.cols, mine - first, row_px[first:last], col_px[first:last], s_i[first:last],
            sd_px[first:last], options,
        )  # fmt: skip
        blocks.append(Block(first, last, ints, floats))
    return tuple(blocks)
