"""What a validation's document says of held-out data, read without trust in its form."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, TypeGuard

from stcal.metrics import MARGINS
from stcal.times import parse_utc


def worse(document: Mapping[str, Any]) -> Iterator[str]:
    """Yield where a validation's figures are worse with confidence, or missing.

    A verdict alone is a word. The margins are the validation's; availability is worse when the two
    intervals lie apart.
    """
    old, new = (_interval_at(document, "availability", "interval", k)
                for k in ("baseline", "candidate"))  # fmt: skip
    if old is None or new is None:
        yield "validation has no intervals of availability"
    elif new[1] < old[0] - MARGINS["availability"]:
        yield f"availability {_text(new)} is worse than the parent's {_text(old)}"
    # Beside a parent that matches nothing there is no ratio.
    if at(document, "matched_stars", "baseline") != 0:
        stars = _interval_at(document, "matched_star_ratio_interval")
        if stars is None:
            yield "validation has no interval of matched_star_ratio"
        elif stars[1] < 1.0 - MARGINS["matched stars"]:
            yield f"matched_star_ratio is {_text(stars)}"
    rms = _interval_at(document, "rms_ratio_interval")
    if rms is None:
        yield "validation has no interval of rms_ratio"
    elif rms[0] > 1.0 + MARGINS["common-pair RMS"]:
        yield f"rms_ratio of the common pairs is {_text(rms)}"


def at(document: Any, *keys: str) -> Any:
    """Return what a JSON document has under nested keys, None where one is missing."""
    for key in keys:
        document = document.get(key) if isinstance(document, Mapping) else None
    return document


def _interval_at(document: Mapping[str, Any], *keys: str) -> tuple[float, float] | None:
    found = at(document, *keys)
    if not isinstance(found, list) or len(found) != 2 or not all(map(is_number, found)):
        return None
    return (found[0], found[1]) if found[0] <= found[1] else None


def _text(interval: tuple[float, float]) -> str:
    return f"{interval[0]:.4g} to {interval[1]:.4g}"


def tai_ns(text: Any) -> int | None:
    """Return TAI ns of a UTC time of a JSON document, None when it is none."""
    try:
        return parse_utc(text) if isinstance(text, str) else None
    except ValueError:
        return None


def is_number(value: Any) -> TypeGuard[float]:
    """Whether a value of a JSON document is a number that fits a float."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer beyond every float
        return False
