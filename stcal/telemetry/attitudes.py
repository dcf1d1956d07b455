"""A record of the body's attitude as CSV, for ``stcal align``.

One row per attitude: ``time_utc``, ``q_x, q_y, q_z, q_w`` (B relative to I, scalar last, as the
telemetry's quaternion is of S), and optionally the noise of the attitude, ``sd_urad`` for all axes
of B or ``sd_x_urad, sd_y_urad, sd_z_urad``.  Rows without a quaternion are gaps; other columns are
ignored; the order of rows doesn't matter.  I is the ICRF: an attitude that was solved without
aberration is off by up to 20 arcsec, and the alignment with it.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as arrow_csv
from numpy.typing import NDArray

from stcal.constants import URAD
from stcal.errors import InputError
from stcal.pipeline.body_attitude import BodyAttitudes
from stcal.telemetry import values
from stcal.telemetry.sources import SourceFile, examine, stream

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_TIME = "time_utc"
_QUATERNION = ("q_x", "q_y", "q_z", "q_w")
_SD = "sd_urad"
_SD_AXES = ("sd_x_urad", "sd_y_urad", "sd_z_urad")
_KNOWN = (_TIME, *_QUATERNION, _SD, *_SD_AXES)
_NORM_TOLERANCE = 1e-3
_LARGEST_SD_URAD = 1e6
# The header is row 1.
_FIRST_ROW = 2


def read_attitudes(path: Path) -> BodyAttitudes:
    """Read an attitude record, plain or gzip.

    Raises
    ------
    InputError
        Naming the file, the row and what is wrong with it.
    """
    source = examine(path)
    if source.truncated:
        raise InputError(f"{path}: the gzip stream is cut; get the file again")
    text = _columns(source)
    t_tai_ns, bad = values.times(text[_TIME])
    _refuse(path, bad, f"{_TIME} is not an ISO 8601 UTC time such as 2026-01-05T12:00:00.000Z")
    q_bi, known = _quaternions(path, text)
    sd = _noise(path, text, known)
    order = np.flatnonzero(known)[np.argsort(t_tai_ns[known], kind="stable")]
    _refuse_repeated(path, t_tai_ns[order], order)
    if len(order) == 0:
        raise InputError(f"{path}: no row has an attitude")
    covariance = np.eye(3) * (sd[order] * URAD)[:, None, :] ** 2
    origin = {"file": source.name, "sha256": source.sha256}
    return BodyAttitudes(t_tai_ns[order], q_bi[order], covariance, origin)


def _columns(source: SourceFile) -> dict[str, Any]:
    """Return the columns of the record as Arrow string arrays, without spaces around the values."""
    data = b"".join(stream(source)).removeprefix(b"\xef\xbb\xbf")
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        row = data.count(b"\n", 0, error.start) + 1
        raise InputError(f"{source.path}: row {row}: is not UTF-8") from None
    header, _, rows = data.partition(b"\n")
    names = _header(source.path, header.decode().rstrip("\r"))
    wanted = {name: str(k) for k, name in enumerate(names) if name in _KNOWN}
    table = _parsed(source.path, rows.rstrip(b"\r\n"), len(names), list(wanted.values()))
    return {name: values.strip(table[place].combine_chunks()) for name, place in wanted.items()}


def _header(path: Path, line: str) -> list[str]:
    where = f"{path}: row 1"
    try:
        names = [name.strip() for name in next(csv.reader([line], strict=True), [])]
    except csv.Error as error:
        raise InputError(f"{where}: the header is not CSV text: {error}") from None
    missing = [name for name in (_TIME, *_QUATERNION) if name not in names]
    if missing:
        raise InputError(f"{where}: missing column(s): {', '.join(missing)}")
    repeated = [name for name in _KNOWN if names.count(name) > 1]
    if repeated:
        raise InputError(f"{where}: column(s) given more than once: {', '.join(repeated)}")
    axes = [name for name in _SD_AXES if name in names]
    if axes and (_SD in names or len(axes) < len(_SD_AXES)):
        raise InputError(f"{where}: the noise is either {_SD} or all of {', '.join(_SD_AXES)}")
    return names


def _parsed(path: Path, rows: bytes, width: int, wanted: list[str]) -> pa.Table:
    """Return the columns at the places ``wanted`` as text."""
    if not rows:
        raise InputError(f"{path}: no row has an attitude")
    wrong: list[Any] = []

    def note(row: Any) -> str:
        wrong.append(row)
        return "error"

    try:
        table = arrow_csv.read_csv(
            io.BytesIO(rows + b"\n"),
            # Rows have numbers only for a single thread.
            read_options=arrow_csv.ReadOptions(
                use_threads=False,
                block_size=len(rows) + 2,
                column_names=[str(k) for k in range(width)],
            ),
            parse_options=arrow_csv.ParseOptions(
                ignore_empty_lines=False, invalid_row_handler=note
            ),
            convert_options=arrow_csv.ConvertOptions(
                column_types=dict.fromkeys(wanted, pa.string()), include_columns=wanted
            ),
        )
    except pa.ArrowInvalid as error:
        if not wrong:
            raise InputError(f"{path}: {str(error).splitlines()[0]}") from None
        number = wrong[0].number + _FIRST_ROW - 1
        fields = f"{wrong[0].actual_columns} fields, the header has {width}"
        raise InputError(f"{path}: row {number}: {fields}") from None
    if table.num_rows != rows.count(b"\n") + 1:
        raise InputError(f"{path}: a quoted field goes over the end of its row")
    return table


def _quaternions(path: Path, text: dict[str, Any]) -> tuple[Floats, Bools]:
    """Return unit quaternions (R, 4) and the rows (R,) that have one."""
    columns = [_numbers(path, text, name) for name in _QUATERNION]
    q_bi = np.stack(columns, axis=1)
    given = np.isfinite(q_bi)
    known = np.asarray(given.all(axis=1))
    _refuse(path, given.any(axis=1) & ~known, "the quaternion is not whole")
    norm = np.linalg.norm(np.where(known[:, None], q_bi, 0.5), axis=1)
    _refuse(path, np.abs(norm - 1.0) > _NORM_TOLERANCE, "the quaternion is not of unit norm", norm)
    return q_bi / norm[:, None], known


def _noise(path: Path, text: dict[str, Any], known: Bools) -> Floats:
    """Return the sd (R, 3) [urad] about the axes of B, zero where the record has none."""
    names = [name for name in (_SD, *_SD_AXES) if name in text]
    if not names:
        return np.zeros((len(known), 3))
    columns = [_numbers(path, text, name) for name in names]
    for name, sd in zip(names, columns, strict=True):
        usable = (sd >= 0.0) & (sd <= _LARGEST_SD_URAD)
        _refuse(path, known & ~usable, f"{name} is missing, negative or absurd")
    return np.broadcast_to(np.stack(columns, axis=1), (len(known), 3))


def _numbers(path: Path, text: dict[str, Any], name: str) -> Floats:
    found, bad = values.numbers(text[name])
    _refuse(path, bad, f"{name} is not a number")
    return found


def _refuse(path: Path, bad: Bools, reason: str, value: Floats | None = None) -> None:
    """Raise for the first bad row (R,), if any."""
    rows = np.flatnonzero(bad)
    if len(rows):
        given = "" if value is None else f" ({value[rows[0]]:.6g})"
        more = f", and {len(rows) - 1} more such rows" if len(rows) > 1 else ""
        raise InputError(f"{path}: row {rows[0] + _FIRST_ROW}: {reason}{given}{more}")


def _refuse_repeated(path: Path, t_tai_ns: Ints, row: Ints) -> None:
    repeated = np.flatnonzero(np.diff(t_tai_ns) == 0)
    if len(repeated):
        a, b = sorted(int(row[repeated[0] + k]) + _FIRST_ROW for k in (0, 1))
        raise InputError(f"{path}: row {b}: the time of row {a} again")
