"""A study's findings: what a paper claims, what the numbers say here, and the verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.report.format import fixed

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Document = Mapping[str, Any]

HOLDS, PARTLY, FAILS, OPEN = "holds", "partly", "does not hold", "not tested"
_UNTESTED = "No sensor of this run can tell."


@dataclass(frozen=True)
class Claim:
    """A published finding.

    Attributes
    ----------
    title : the finding in a line
    section : where the paper states it
    paper : what the paper says
    why : by verdict, the likely reason for what is found here
    """

    title: str
    section: str
    paper: str
    why: Mapping[str, str]

    def judged(self, verdict: str, here: str) -> dict[str, str]:
        """Return the finding as the document has it; ``here`` are the numbers of this run."""
        return {
            "title": self.title,
            "section": self.section,
            "paper": self.paper,
            "here": here,
            "verdict": verdict,
            "why": self.why.get(verdict, _UNTESTED),
        }


def verdict_of(hits: Bools, partly: bool | None = None) -> str:
    """Return the verdict on a claim about every sensor, given where it is true.

    ``partly`` says whether the claim is partly true where it isn't true everywhere; by default,
    when it is true of half the sensors or more.
    """
    if not len(hits):
        return OPEN
    if hits.all():
        return HOLDS
    if partly is None:
        partly = bool(2 * hits.sum() >= len(hits))
    return PARTLY if partly else FAILS


def number_at(document: Any, *keys: str) -> float:
    """Return the number at a path of keys, NaN where there is none."""
    for key in keys:
        document = document.get(key) if isinstance(document, Mapping) else None
    is_number = isinstance(document, int | float) and not isinstance(document, bool)
    return float(document) if is_number else math.nan


def listed(values: Floats, decimals: int, unit: str = "", signed: bool = True) -> str:
    """Return the sensors' values as text: ``+0.5, −0.1 %``."""
    shown = ", ".join(fixed(float(value), decimals, signed=signed) for value in values)
    return f"{shown} {unit}".rstrip()


def named(sensors: Sequence[Document]) -> str:
    """Return which sensors a list of values belongs to: ``Sensors 1, 2, 3``."""
    numbers = [str(sensor["number"]) for sensor in sensors]
    return f"Sensor{'s' if len(numbers) > 1 else ''} {', '.join(numbers)}"


def out_of(hits: Bools) -> str:
    """Return how many sensors of all: ``5 of 6``."""
    return f"{int(hits.sum())} of {len(hits)}"
