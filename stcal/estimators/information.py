"""The mergeable partial: a square-root information factor with its right-hand side."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class SquareRootInformation:
    """Triangular factor of [H | r]: R^T R = [H | r]^T [H | r].

    Attributes
    ----------
    factor : (P + 1, P + 1) upper triangular
    rows : number of independent residuals that went in
    """

    factor: Floats
    rows: int

    @property
    def chi2(self) -> float:
        """Sum of squared whitened residuals at the point of linearisation."""
        return float((self.factor[:, -1] ** 2).sum())

    @property
    def root(self) -> Floats:
        """(P, P) upper triangular square root of the information matrix H^T H."""
        return self.factor[:-1, :-1]

    @property
    def projected(self) -> Floats:
        """(P,) residuals projected on the columns of H."""
        return self.factor[:-1, -1]


def reduce_rows(rows: Floats, count: int) -> SquareRootInformation:
    """Reduce whitened rows [H | r] (A, P + 1) by QR."""
    width = rows.shape[1]
    factor = _triangle(rows)
    if len(factor) < width:
        factor = np.vstack([factor, np.zeros((width - len(factor), width))])
    return SquareRootInformation(factor, count)


def _triangle(rows: Floats) -> Floats:
    return np.asarray(np.linalg.qr(rows, mode="r"))


def merge(partials: Iterable[SquareRootInformation]) -> SquareRootInformation:
    """Merge partials by QR in the order given, so that the result is bitwise repeatable."""
    total: SquareRootInformation | None = None
    for partial in partials:
        if total is None:
            total = partial
            continue
        stacked = np.vstack([total.factor, partial.factor])
        total = SquareRootInformation(_triangle(stacked), total.rows + partial.rows)
    if total is None:
        raise ValueError("nothing to merge")
    return total


def scaled(information: SquareRootInformation, scale: Floats) -> SquareRootInformation:
    """Return the factor for parameters divided by ``scale`` (P,), Enright 2018 eq (23)."""
    columns = np.append(scale, 1.0)
    return SquareRootInformation(information.factor * columns, information.rows)
