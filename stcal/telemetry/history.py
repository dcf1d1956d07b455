"""A sequential filter's history as a Parquet file: one row per frame."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from stcal.errors import InputError
from stcal.pipeline.filter_run import EVENTS, FrameHistory
from stcal.pipeline.filtering import Filter
from stcal.telemetry.parquet import reading, write
from stcal.times import utc_from_tai_ns

Floats = NDArray[np.float64]

_PLAIN = ("frame_id", "nis", "log_determinant", "arcs", "noise_scale", "fixed", "fixed_baseline",
          "matched", "matched_baseline", "rejected", "iterations", "on_baseline")  # fmt: skip


_NULLABLE = ("nis", "log_determinant", "temperature_c")
_KINDS: dict[str, pa.DataType] = {
    **dict.fromkeys(("frame_id", "t_tai_ns", "arcs", "matched", "matched_baseline", "rejected",
                     "iterations"), pa.int64()),
    **dict.fromkeys(("noise_scale", *_NULLABLE), pa.float64()),
    **dict.fromkeys(("fixed", "fixed_baseline", "on_baseline"), pa.bool_()),
    "innovations": pa.list_(pa.float64()),
    "event": pa.string(),
}  # fmt: skip


def write_history(history: FrameHistory, chosen: Filter, path: Path) -> None:
    """Write a history.

    Parameters are those at the reference temperature, ``<name>`` with ``sd_<name>``, in their own
    units; slopes by temperature, ``<name>_per_k``; ``innovations`` the frame's standardised
    innovations; ``event`` why the filter fell back to the baseline, empty where it did not.  The
    state itself (``state``, ``state_sd``) is kept, so that a run can go on without loss.
    """
    columns: dict[str, Any] = {name: getattr(history, name) for name in _PLAIN}
    columns |= _parameters(history, chosen)
    offsets = np.concatenate(([0], np.cumsum(history.innovations))).astype(np.int32)
    columns |= {
        "time_utc": pa.array(utc_from_tai_ns(history.t_tai_ns), pa.timestamp("ns", tz="UTC")),
        "t_tai_ns": history.t_tai_ns,
        "temperature_c": pa.array(history.temperature_c, from_pandas=True),
        "nis": pa.array(history.nis, from_pandas=True),
        "log_determinant": pa.array(history.log_determinant, from_pandas=True),
        "innovations": pa.ListArray.from_arrays(offsets, history.innovation),
        "event": pa.array([EVENTS[k] for k in history.event]),
        "state": _rows(history.x),
        "state_sd": _rows(history.sd),
    }
    write(path, pa.table(columns))


def _parameters(history: FrameHistory, chosen: Filter) -> dict[str, Floats]:
    values = chosen.parameters(history.x)
    columns = {}
    for k, name in enumerate(chosen.names):
        scale = chosen.model.scale[k]
        if chosen.model.thermal[k]:
            columns[f"{name}_per_k"] = history.x[:, k] * scale
            columns[f"sd_{name}_per_k"] = history.sd[:, k] * scale
        else:
            columns[name] = values[:, chosen.model.target[k]]
            columns[f"sd_{name}"] = history.sd[:, k] * scale
    return columns


def _rows(table: Floats) -> pa.Array:
    return pa.FixedSizeListArray.from_arrays(table.ravel(), table.shape[1])


def read_history(path: Path, states: int) -> FrameHistory:
    """Read a history to go on from; ``states`` is the number of states that it must have.

    Raises
    ------
    InputError
        Naming the file: damaged, or of another filter.
    """
    with reading(path, "history of a filter") as file:
        table = file.read()
    _check(table, states, path)
    columns: dict[str, Any] = {name: _numpy(table, name) for name in _PLAIN}
    listed = table.column("innovations").combine_chunks()
    x, sd = (_states(table, name) for name in ("state", "state_sd"))
    return FrameHistory(
        **columns,
        t_tai_ns=_numpy(table, "t_tai_ns"),
        temperature_c=_numpy(table, "temperature_c"),
        x=x,
        sd=sd,
        innovation=listed.flatten().to_numpy(zero_copy_only=False),
        innovations=listed.value_lengths().to_numpy(zero_copy_only=False).astype(np.int64),
        event=np.array([EVENTS.index(e) for e in table.column("event").to_pylist()], np.int8),
    )


def _numpy(table: pa.Table, name: str) -> Any:
    return table.column(name).to_numpy()


def _states(table: pa.Table, name: str) -> Floats:
    column = table.column(name).combine_chunks()
    rows: Floats = column.flatten().to_numpy(zero_copy_only=False)
    return rows.reshape(-1, column.type.list_size)


def _check(table: pa.Table, states: int, path: Path) -> None:
    """Refuse a table that :func:`write_history` didn't write for so many states.

    Raises
    ------
    InputError
        Naming the file and the column.
    """
    kinds = _KINDS | dict.fromkeys(("state", "state_sd"), pa.list_(pa.float64(), states))
    for name, kind in kinds.items():
        if name not in table.column_names:
            raise InputError(f"{path}: damaged history of a filter: no column {name}")
        column = table.column(name)
        if name == "state" and getattr(column.type, "list_size", states) != states:
            raise InputError(f"{path}: has {column.type.list_size} states, this filter {states}")
        if column.type != kind:
            raise InputError(f"{path}: column {name} is {column.type}, not {kind}")
        if column.null_count and name not in _NULLABLE:
            raise InputError(f"{path}: damaged history of a filter: column {name} has gaps")
    unknown = set(table.column("event").to_pylist()) - set(EVENTS)
    if unknown or not table.num_rows:
        what = f"unknown event {min(unknown)!r}" if unknown else "no rows"
        raise InputError(f"{path}: damaged history of a filter: {what}")
