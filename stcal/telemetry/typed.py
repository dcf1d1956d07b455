"""Columns whose values need no parsing: what a binary format gives instead of text."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from stcal.frames import Bools, Ints


@dataclass(frozen=True)
class Typed:
    """A column of n values.

    Attributes
    ----------
    values : (n,) real numbers (NaN where empty or bad) or int64 (0 there)
    bad : (n,) whether the value is not one that the column may have
    empty : (n,) whether there is none
    """

    values: Any
    bad: Bools
    empty: Bools

    def __len__(self) -> int:
        """Return n."""
        return len(self.values)

    def take(self, index: Ints) -> Typed:
        """Return the values at these places."""
        return Typed(self.values[index], self.bad[index], self.empty[index])

    def __getitem__(self, i: int) -> Any:
        """Return value i as the text that a CSV file would have, as a text column does."""
        return pa.scalar("" if self.empty[i] else str(self.values[i]))
