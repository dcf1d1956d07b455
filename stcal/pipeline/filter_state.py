"""The state of a sequential filter between telemetry frames, and its file ``stcal.filter/1``.

A pass that stops after any frame and goes on from the file gives bitwise what one pass gives:
floats are written so that they are read back exactly, and a hash of the content tells damage.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.atomic import write_text
from stcal.calibration import canonical_json
from stcal.errors import InputError
from stcal.reading import read_json_object

SCHEMA = "stcal.filter/1"
Floats = NDArray[np.float64]

_ARRAYS = ("x", "root", "base_x", "base_root", "linearised_at", "sloped_at", "tally", "window",
           "kept_star", "kept_c_di", "kept_facts", "kept_after")  # fmt: skip


@dataclass(frozen=True)
class FilterState:
    """State of one filter after a frame.

    Attributes
    ----------
    x : (n,) estimate, departures from the reference in units of the state's scale
    root : (n, n) square root of the covariance, of the estimator's own kind
    base_x, base_root : the same before the frames that are kept for being linearised anew
    linearised_at, sloped_at : (n,) the state at which these were linearised, and that at which the
        slopes of the noise were found
    tally, window : what the watch over the filter counts (``watch_kernels``)
    kept_star, kept_c_di, kept_facts, kept_after : those frames, oldest first (``Kept``)
    last_t_tai_ns : time of the last frame, None before the first
    last_frame_id : its number
    """

    x: Floats
    root: Floats
    base_x: Floats
    base_root: Floats
    linearised_at: Floats
    sloped_at: Floats
    tally: Floats
    window: Floats
    kept_star: Floats
    kept_c_di: Floats
    kept_facts: Floats
    kept_after: Floats
    last_t_tai_ns: int | None = None
    last_frame_id: int | None = None


@dataclass(frozen=True)
class StateFile:
    """The filters of a run by name, with what they belong to.

    ``setting`` is everything that must be the same for the run to go on: sensor, variant of the
    filter, and the hashes of baseline calibration, configuration and catalogue.
    """

    setting: dict[str, Any]
    filters: dict[str, FilterState]


def save_state(state: StateFile, path: Path) -> None:
    """Write the state file atomically."""
    filters = {
        name: {key: getattr(one, key).tolist() for key in _ARRAYS}
        | {"last_t_tai_ns": one.last_t_tai_ns, "last_frame_id": one.last_frame_id}
        for name, one in state.filters.items()
    }
    document = {"schema": SCHEMA, "setting": state.setting, "filters": filters}
    write_text(path, canonical_json(document | {"sha256": _hash(document)}))


def _hash(document: dict[str, Any]) -> str:
    try:
        return hashlib.sha256(canonical_json(document).encode()).hexdigest()
    except ValueError:  # a number that is not finite: never written
        return ""


def load_state(path: Path, setting: dict[str, Any]) -> dict[str, FilterState]:
    """Read a state file and check that it belongs to this run.

    Raises
    ------
    InputError
        Naming the file and what is wrong with it or differs from this run.
    """
    document = read_json_object(path)
    if document.get("schema") != SCHEMA:
        raise InputError(f"{path}: schema is {document.get('schema')!r}, not {SCHEMA!r}")
    content = {key: document.get(key) for key in ("schema", "setting", "filters")}
    expected = _hash(content)
    if not expected or document.get("sha256") != expected:
        raise InputError(f"{path}: damaged: its content does not agree with its hash")
    found, filters = dict(content["setting"] or {}), dict(content["filters"] or {})
    for key in sorted(set(setting) | set(found)):
        if setting.get(key) != found.get(key):
            raise InputError(
                f"{path}: was made with {key} {found.get(key)!r}, this run has {setting.get(key)!r}"
            )
    return {name: _filter(section) for name, section in filters.items()}


def _filter(section: dict[str, Any]) -> FilterState:
    """Return a filter's state; lists that are empty get their dimensions back."""
    arrays = {key: np.array(section[key], dtype=np.float64) for key in _ARRAYS}
    n, count = len(section["x"]), len(section["kept_star"])
    stars = len(section["kept_star"][0]) if count else 0
    shapes = {
        "kept_star": (count, stars, 6),
        "kept_c_di": (count, 2, 3, 3),
        "kept_facts": (count, 4),
        "kept_after": (count, n + 1, n),
    }
    arrays |= {key: arrays[key].reshape(shape) for key, shape in shapes.items()}
    return FilterState(
        **arrays,
        last_t_tai_ns=section["last_t_tai_ns"],
        last_frame_id=section["last_frame_id"],
    )
