"""Compiled look at the fields of delimited lines: where they are, which repeat, plain values.

What is not plain (an exponent, many digits, spaces, an identifier other than Hipparcos's) is left
to the general way, so that there is one set of rules for what a text means.
"""

from __future__ import annotations

import numpy as np

from stcal.catalog.identifiers import HIP_LIMIT
from stcal.jit import kernel

# What a field is.
PLAIN, EMPTY, OTHER = 0, 1, 2
# Up to so many digits, number and power of ten are exact in double precision, so that their
# quotient is the nearest double to the text (Clinger 1990).
_MOST_DIGITS = 15
_POWERS = 10.0 ** np.arange(_MOST_DIGITS + 1)
_ZERO, _NINE, _POINT, _MINUS = 48, 57, 46, 45
_CR, _QUOTE, _BEYOND_ASCII = 13, 34, 128
_HIP = np.frombuffer(b"HIP ", np.uint8)
_MOST_HIP_DIGITS = 6


@kernel
def count_fields(data, start, stop, delimiter, fields):
    """Fill the number of fields of each line, taken as unquoted.

    Returns whether the lines hold anything beside plain ASCII text: NUL, carriage returns, quotes,
    or bytes beyond ASCII.
    """
    special = False
    for i in range(len(start)):
        count = 1
        for p in range(start[i], stop[i]):
            byte = data[p]
            count += byte == delimiter
            special |= (byte == 0) | (byte == _CR) | (byte == _QUOTE) | (byte >= _BEYOND_ASCII)
        fields[i] = count
    return special


@kernel
def find_fields(data, start, end, delimiter, bounds):
    """Fill ``bounds`` (n, columns + 1): where the fields of lines begin.

    Field c of line i is ``data[bounds[i, c] : bounds[i, c + 1] - 1]``.
    """
    for i in range(len(start)):
        bounds[i, 0] = start[i]
        column = 1
        for p in range(start[i], end[i]):
            if data[p] == delimiter:
                bounds[i, column] = p + 1
                column += 1
        bounds[i, column] = end[i] + 1


@kernel
def begins(data, bounds, key, columns, out):
    """Mark the lines whose ``key`` fields are not those of the line before, and the first.

    Returns whether all others have the same fields ``columns`` as the line before.
    """
    for i in range(len(bounds)):
        out[i] = i == 0 or not _same(data, bounds[i - 1], bounds[i], key)
        if not out[i] and not _same(data, bounds[i - 1], bounds[i], columns):
            return False
    return True


@kernel
def _same(data, before, line, columns):
    for c in columns:
        first, length = line[c], line[c + 1] - line[c] - 1
        shift = before[c] - first
        if before[c + 1] - before[c] - 1 != length:
            return False
        for p in range(first, first + length):
            if data[p] != data[p + shift]:
                return False
    return True


@kernel
def numbers(data, bounds, column, values, kind):
    """Fill the plain decimal numbers of a column, NaN elsewhere, and what each field is."""
    for i in range(len(bounds)):
        values[i], kind[i] = _number(data, bounds[i, column], bounds[i, column + 1] - 1)


@kernel
def _number(data, first, stop):
    if first == stop:
        return np.nan, EMPTY
    negative = data[first] == _MINUS
    p = first + 1 if negative else first
    whole, digits, decimals = np.int64(0), 0, -1
    for q in range(p, stop):
        if _ZERO <= data[q] <= _NINE:
            if digits == _MOST_DIGITS:
                return np.nan, OTHER
            whole = 10 * whole + np.int64(data[q]) - _ZERO
            digits += 1
            if decimals >= 0:
                decimals += 1
        elif data[q] == _POINT and decimals < 0 and digits > 0:
            decimals = 0
        else:
            return np.nan, OTHER
    if digits == 0 or decimals == 0:
        return np.nan, OTHER
    value = whole / _POWERS[max(decimals, 0)]
    # Not -value: telemetry has no negative zero.
    return (0.0 - value if negative else value), PLAIN


@kernel
def hipparcos(data, bounds, column, codes, kind):
    """Fill the Hipparcos numbers of a column, 0 elsewhere, and what each field is."""
    for i in range(len(bounds)):
        codes[i], kind[i] = _hipparcos(data, bounds[i, column], bounds[i, column + 1] - 1)


@kernel
def _hipparcos(data, first, stop):
    if first == stop:
        return 0, EMPTY
    digits = stop - first - len(_HIP)
    if not 1 <= digits <= _MOST_HIP_DIGITS:
        return 0, OTHER
    for k in range(len(_HIP)):
        if data[first + k] != _HIP[k]:
            return 0, OTHER
    number = np.int64(0)
    for p in range(first + len(_HIP), stop):
        if not _ZERO <= data[p] <= _NINE:
            return 0, OTHER
        number = 10 * number + np.int64(data[p]) - _ZERO
    if not 1 <= number <= HIP_LIMIT:
        return 0, OTHER
    return number, PLAIN
