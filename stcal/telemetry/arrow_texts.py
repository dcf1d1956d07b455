"""Arrow columns of any plain type as the text that the long form would have."""

from __future__ import annotations

from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from stcal.errors import InputError


def texts_of(column: Any, name: str) -> Any:
    """Return a column as text; NaN is no value, as in tables that know no other way.

    Raises
    ------
    InputError
        Naming the column: it holds something that is no text, number or truth value.
    """
    kind = column.type
    if pa.types.is_dictionary(kind):
        column, kind = column.dictionary_decode(), kind.value_type
    if pa.types.is_boolean(kind):
        column = pc.cast(column, pa.int8())
    if pa.types.is_floating(kind):
        # By way of double: a single's shortest text is not its value.
        real = pc.cast(column, pa.float64())
        column = pc.if_else(pc.is_nan(real), None, real)
    try:
        return pc.cast(column, pa.string())
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
        raise InputError(f"column {name!r} is {kind}, not text or numbers: {error}") from None
