"""Partial results that add up, fragment by fragment in their order."""

from __future__ import annotations

from collections.abc import Iterable
from functools import reduce
from typing import Any, Protocol, Self, TypeVar


class Additive(Protocol):
    """A partial result of consecutive frames."""

    def __add__(self, other: Any) -> Any:
        """Return the result of both, this one's frames being the earlier."""


S = TypeVar("S", bound=Additive)


class Sums:
    """A dataclass whose fields are numbers or arrays that all add up."""

    def __add__(self, other: Self) -> Self:
        """Return the sums of both."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return type(self)(*(a + b for a, b in pairs))


def total(parts: Iterable[S]) -> S:
    """Add up partial results, in order."""
    return reduce(lambda a, b: a + b, parts)
