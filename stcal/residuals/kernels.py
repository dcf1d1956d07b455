"""The compiled residuals by name; apart from stcal.residuals, which stays free of numba."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from stcal.residuals import (
    arclength_kernels,
    cosine_kernels,
    direction_kernels,
    singular_value_kernels,
)


@dataclass(frozen=True)
class ResidualKernels:
    """Function pointers of one residual (``contract_kernels``)."""

    bind: Any
    rows: Any


RESIDUAL_KERNELS: dict[str, ResidualKernels] = {
    "arclength": ResidualKernels(arclength_kernels.bind, arclength_kernels.rows),
    "direction": ResidualKernels(direction_kernels.bind, direction_kernels.rows),
    "singular-values": ResidualKernels(singular_value_kernels.bind, singular_value_kernels.rows),
    "cosine": ResidualKernels(cosine_kernels.bind, cosine_kernels.rows),
}
