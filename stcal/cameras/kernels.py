"""Compiled cameras by model name: twins of CAMERAS for kernels that go exposure by exposure.

A kernel takes one as an argument of type ``numba.types.FunctionType(CAMERA_SIGNATURE)``, so that it
is compiled once for all models.  Apart from stcal.cameras, which stays free of numba.
"""

from __future__ import annotations

from typing import Any

from stcal.cameras.unit_kernels import CAMERA_SIGNATURE
from stcal.jit import KernelTable

CAMERA_KERNELS: KernelTable[Any] = KernelTable(
    {
        "wang": "stcal.cameras.wang_kernels",
        "pinhole-radial": "stcal.cameras.pinhole_radial_kernels",
        "pixel-radial": "stcal.cameras.pixel_radial_kernels",
    },
    lambda module: module.evaluate,
)

__all__ = ["CAMERA_KERNELS", "CAMERA_SIGNATURE"]
