"""Compiled cameras by model name: twins of CAMERAS for filters that run frame by frame.

A filter's kernel takes one as an argument of type ``numba.types.FunctionType(CAMERA_SIGNATURE)``,
so that it is compiled once for all models.  Apart from stcal.cameras, which stays free of numba.
"""

from __future__ import annotations

from typing import Any

from stcal.cameras import pinhole_radial_kernels, pixel_radial_kernels, wang_kernels
from stcal.cameras.unit_kernels import CAMERA_SIGNATURE

CAMERA_KERNELS: dict[str, Any] = {
    "wang": wang_kernels.evaluate,
    "pinhole-radial": pinhole_radial_kernels.evaluate,
    "pixel-radial": pixel_radial_kernels.evaluate,
}

__all__ = ["CAMERA_KERNELS", "CAMERA_SIGNATURE"]
