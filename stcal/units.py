"""Units of camera parameters, derived from the suffix of their names.

``f_m`` is in m, ``b4_per_m4`` in m^-4, ``a1_rad`` in rad, ``g_y`` has no unit: a new camera model
gets its units from the names that it gives its parameters.  Each unit has a multiple in which its
usual values read easily; for the inverse powers it follows Enright 2018 Table II (1e3 m^-2,
1e8 m^-4) and Zhang 2024 (1e-8 px^-2, 1e-14 px^-4), continued to other powers.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

_INVERSE_POWER = re.compile(r"^(?P<symbol>.+)_per_(?P<base>m|px)(?P<power>\d+)$")
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
# suffix -> (unit of the value, unit shown, value of one shown unit)
_SUFFIXES = {
    "_px": ("px", "px", 1.0),
    "_rad": ("rad", "mrad", 1e-3),
    "_deg": ("deg", "deg", 1.0),
    "_m": ("m", "mm", 1e-3),
}


@dataclass(frozen=True)
class Unit:
    """How one parameter is written.

    Attributes
    ----------
    symbol : the name without its unit, ``b4``
    si : the unit of the value as files hold it, in ASCII, ``m^-4``; ``1`` without a unit
    shown : the unit for reading, ``10⁸ m⁻⁴``; empty without a unit
    size : the value of one shown unit, 1e8
    """

    symbol: str
    si: str
    shown: str
    size: float

    @property
    def label(self) -> str:
        """The symbol with its shown unit, for an axis or a table."""
        return f"{self.symbol} [{self.shown}]" if self.shown else self.symbol


def unit_of(name: str) -> Unit:
    """Return the unit of a camera parameter by its name."""
    match = _INVERSE_POWER.match(name)
    if match is not None:
        base, power = match["base"], int(match["power"])
        exponent = round(2.5 * power - 2) if base == "m" else -(3 * power + 2)
        shown = f"10{_raised(exponent)} {base}{_raised(-power)}"
        return Unit(match["symbol"], f"{base}^-{power}", shown, float(f"1e{exponent}"))
    for suffix, (si, shown, size) in _SUFFIXES.items():
        if name.endswith(suffix) and len(name) > len(suffix):
            return Unit(name.removesuffix(suffix), si, shown, size)
    return Unit(name, "1", "", 1.0)


def _raised(exponent: int) -> str:
    return str(exponent).translate(_SUPERSCRIPT)
