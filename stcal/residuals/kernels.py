"""The compiled residuals by name; apart from stcal.residuals, which stays free of numba."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from stcal.jit import KernelTable


@dataclass(frozen=True)
class ResidualKernels:
    """Function pointers of one residual (``contract_kernels``)."""

    bind: Any
    rows: Any


RESIDUAL_KERNELS: KernelTable[ResidualKernels] = KernelTable(
    {
        "arclength": "stcal.residuals.arclength_kernels",
        "direction": "stcal.residuals.direction_kernels",
        "singular-values": "stcal.residuals.singular_value_kernels",
        "cosine": "stcal.residuals.cosine_kernels",
    },
    lambda module: ResidualKernels(module.bind, module.rows),
)
