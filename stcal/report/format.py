"""Numbers as text, the same on the terminal and in the HTML report."""

from __future__ import annotations

import math
from typing import Any

from stcal.report.document import number, numbers, text

NOT_AVAILABLE = "not available"
_MINUS = "\N{MINUS SIGN}"


def fixed(value: Any, decimals: int = 2, unit: str = "", signed: bool = False) -> str:
    """Return a number with a fixed count of decimals and its unit."""
    found = number(value)
    if found is None:
        return NOT_AVAILABLE
    if abs(found) >= 1e9:
        return _with_unit(f"{found:.4g}", unit)
    body = f"{found:+.{decimals}f}" if signed else f"{found:.{decimals}f}"
    if float(body) == 0.0:
        body = body.lstrip("+-")
    return _with_unit(body, unit)


def significant(value: Any, digits: int = 4, unit: str = "") -> str:
    """Return a number with a count of significant digits and its unit."""
    found = number(value)
    return NOT_AVAILABLE if found is None else _with_unit(f"{found:.{digits}g}", unit)


def count(value: Any) -> str:
    """Return a whole number with thin groups of three digits."""
    found = number(value)
    if found is None:
        return NOT_AVAILABLE
    if abs(found) >= 1e15:
        return f"{found:.4g}"
    return _with_unit(f"{found:,.0f}".replace(",", "\N{NARROW NO-BREAK SPACE}"), "")


def percent(value: Any) -> str:
    """Return a share as a percentage."""
    found = number(value)
    return fixed(None if found is None else 100.0 * found, 1, "%")


def share(value: Any) -> str:
    """A share as a percentage, a whole one without decimals."""
    return percent(value).replace(".0 %", " %")


def rms(value: Any) -> str:
    """Return an RMS in µrad: one decimal below 1000, none above."""
    found = number(value)
    return fixed(found, 1 if found is None or found < 1000.0 else 0)


def measured(value: Any, sd: Any, signed: bool = False) -> str:
    """Return a number with the decimals that its sd justifies (two digits of the sd)."""
    return fixed(value, decimals_for(sd), signed=signed) if _usable(sd) else significant(value, 6)


def spread(sd: Any) -> str:
    """Return an sd with two significant digits."""
    return fixed(sd, decimals_for(sd)) if _usable(sd) else significant(sd, 2)


def decimals_for(sd: Any) -> int:
    """Return the decimals that show two significant digits of an sd."""
    found = number(sd)
    if found is None or found <= 0.0:
        return 6
    return min(max(1 - math.floor(math.log10(found)), 0), 12)


def interval(bounds: Any, decimals: int, factor: float = 1.0, unit: str = "") -> str:
    """Return ``low to high`` of a pair."""
    pair = numbers(bounds)
    if len(pair) != 2 or not all(map(math.isfinite, pair)):
        return NOT_AVAILABLE
    low, high = (fixed(factor * float(item), decimals) for item in pair)
    return _with_unit(f"{low} to {high}", unit)


def vector(value: Any, decimals: int = 2, unit: str = "", signed: bool = True) -> str:
    """Return the components of a vector."""
    items = [number(item) for item in value] if isinstance(value, list | tuple) else []
    if not items or any(item is None for item in items):
        return NOT_AVAILABLE
    return _with_unit(", ".join(fixed(item, decimals, signed=signed) for item in items), unit)


def words(value: Any) -> str:
    """Return text, or that there is none."""
    return text(value) or NOT_AVAILABLE


def yes_no(value: Any) -> str:
    """Return yes or no."""
    if not isinstance(value, bool):
        return NOT_AVAILABLE
    return "yes" if value else "no"


def _usable(sd: Any) -> bool:
    found = number(sd)
    return found is not None and found > 0.0


def _with_unit(body: str, unit: str) -> str:
    body = body.replace("-", _MINUS) if "e" not in body else body
    return f"{body} {unit}" if unit else body
