"""The star catalogue as columns, its file, and what one sensor can see and tell apart of it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.atomic import write_with
from stcal.catalog import merging
from stcal.constants import ARCSEC
from stcal.errors import InputError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

SCHEMA, VERSION = "stcal.catalogue", 1
BUNDLED = Path(__file__).parent / "data" / "tycho2_bright.npz"

# Columns as the file keeps them, little endian.  A float32 holds any proper motion to 1 uas per
# year and any magnitude to 1e-6.
_STORED: dict[str, str] = {
    "star_id": "<i8",
    "direction": "<f8",
    "motion": "<f4",
    "parallax": "<f4",
    "magnitude": "<f4",
    "colour": "<f4",
    "multiple": "|b1",
    "merged": "|b1",
    "source": "|S1",
}
_VECTORS = ("direction", "motion")
_UNIT_TOLERANCE = 1e-9


@dataclass(frozen=True)
class StarCatalogue:
    """Stars as columns; C is their number.

    Attributes
    ----------
    star_id : (C,) int64 codes of :mod:`stcal.catalog.identifiers`
    direction : (C, 3) ICRS unit vectors at epoch J2000.0
    motion : (C, 3) proper motion, rad per Julian year, tangent to ``direction``; zero where unknown
    parallax : (C,) rad, zero where unknown or negative
    magnitude : (C,) Johnson V
    colour : (C,) Johnson B-V, NaN where unknown
    multiple : (C,) whether the source flags the star as double or multiple
    merged : (C,) whether the row is the photocentre of several stars
    source : (C,) one letter, explained under ``sources`` of the provenance
    provenance : JSON object: what the catalogue was made from and how
    """

    star_id: Ints
    direction: Floats
    motion: Floats
    parallax: Floats
    magnitude: Floats
    colour: Floats
    multiple: Bools
    merged: Bools
    source: NDArray[np.str_]
    provenance: dict[str, Any] = field(default_factory=dict)

    @property
    def n_stars(self) -> int:
        """Number of stars C."""
        return len(self.star_id)

    def take(self, rows: Ints | Bools) -> StarCatalogue:
        """Return the selected rows (mask, or indices in the wanted order)."""
        return replace(self, **{name: getattr(self, name)[rows] for name in _STORED})


def select(
    catalogue: StarCatalogue, limiting_magnitude: float, merge_separation_arcsec: float
) -> StarCatalogue:
    """Return what a sensor sees: close stars merged, then cut by magnitude, brightest first.

    Stars closer than the separation, to the full depth of the catalogue, become one row at their
    photocentre with the sum of their light and the identifier of the brightest; ``merged`` is set.
    Ties in magnitude are ordered by identifier, so the result does not depend on the rows' order.
    """
    brightest_first = np.lexsort((catalogue.star_id, catalogue.magnitude))
    head = merging.brightest_neighbour(
        catalogue.direction, brightest_first, merge_separation_arcsec * ARCSEC
    )
    merged = _merge(catalogue, head)
    seen = merged.take(np.flatnonzero(merged.magnitude <= limiting_magnitude))
    selection = {
        "limiting_magnitude": limiting_magnitude,
        "merge_separation_arcsec": merge_separation_arcsec,
    }
    seen = replace(seen, provenance={**catalogue.provenance, "selection": selection})
    return seen.take(np.lexsort((seen.star_id, seen.magnitude)))


def _merge(catalogue: StarCatalogue, head: Ints) -> StarCatalogue:
    """Return the catalogue with every star folded into its ``head`` (C,) row."""
    rows = np.arange(len(head))
    heads = np.unique(head[head != rows])
    if len(heads) == 0:
        return catalogue
    slot = np.full(len(head), -1)
    slot[heads] = np.arange(len(heads))
    members = np.flatnonzero(slot[head] >= 0)
    # Brightest first, so that sums round the same way whatever the rows' order.
    order = np.lexsort((catalogue.star_id[members], catalogue.magnitude[members]))
    parts = catalogue.take(members[order])
    group, size = slot[head[members[order]]], len(heads)
    flux = merging.flux_of(parts.magnitude)
    direction, motion = merging.photocentre(group, flux, parts.direction, parts.motion, size)
    columns = {name: getattr(catalogue, name).copy() for name in _STORED}
    columns["direction"][heads] = direction
    columns["motion"][heads] = motion
    columns["parallax"][heads] = merging.weighted_mean(group, flux, parts.parallax, size)
    columns["magnitude"][heads] = merging.magnitude_of(merging.group_sum(group, flux, size))
    columns["colour"][heads] = _colour(group, flux, parts.colour, size)
    columns["multiple"][heads] = columns["merged"][heads] = True
    return replace(catalogue, **columns).take(head == rows)


def _colour(group: Ints, flux: Floats, colour: Floats, size: int) -> Floats:
    """Return B-V (size,) of the summed light of the members whose colour is known, else NaN."""
    known = np.isfinite(colour)
    visual = merging.group_sum(group[known], flux[known], size)
    blue = merging.group_sum(group[known], flux[known] * merging.flux_of(colour[known]), size)
    with np.errstate(invalid="ignore"):
        return np.asarray(merging.magnitude_of(blue) - merging.magnitude_of(visual))


def catalogue_sha256(catalogue: StarCatalogue) -> str:
    """Return the hex SHA-256 of the columns as the file keeps them (without the provenance)."""
    return _sha256(_stored_columns(catalogue))


def _stored_columns(catalogue: StarCatalogue) -> dict[str, NDArray[Any]]:
    return {
        name: np.ascontiguousarray(getattr(catalogue, name), dtype=dtype)
        for name, dtype in _STORED.items()
    }


def _sha256(columns: Mapping[str, NDArray[Any]]) -> str:
    digest = hashlib.sha256(f"{SCHEMA}/{VERSION}".encode())
    for name, dtype in _STORED.items():
        digest.update(f"|{name}:{dtype}:{columns[name].shape}|".encode())
        digest.update(columns[name].data)
    return digest.hexdigest()


def save(catalogue: StarCatalogue, path: Path) -> None:
    """Write the catalogue file atomically; equal catalogues give equal bytes."""
    columns = _stored_columns(catalogue)
    header = {
        "schema": SCHEMA,
        "version": VERSION,
        "sha256": _sha256(columns),
        "provenance": catalogue.provenance,
    }
    text = np.frombuffer(json.dumps(header, sort_keys=True).encode(), dtype=np.uint8)
    # Not compressed: it would shrink by a third only, and reading would take four times as long.
    write_with(path, lambda stream: np.savez(stream, allow_pickle=False, header=text, **columns))


@cache
def load_bundled() -> StarCatalogue:
    """Return the catalogue that comes with the package (Tycho-2 to V 8); read once a process."""
    return load(BUNDLED)


def load(path: Path) -> StarCatalogue:
    """Read a catalogue file and verify its SHA-256.

    Raises
    ------
    InputError
        Naming the file: unreadable, cut short, no catalogue, newer schema, altered content.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            header = _header(archive, path)
            columns = {name: archive[name] for name in _STORED}
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except Exception:
        # zipfile, zlib, json and numpy raise a dozen kinds for a cut or foreign file.
        raise InputError(f"{path}: cut short or not a star catalogue") from None
    for problem in _problems(columns, header):
        raise InputError(f"{path}: {problem}")
    return _from_stored(columns, header["provenance"])


def _header(archive: Any, path: Path) -> dict[str, Any]:
    if not isinstance(archive, np.lib.npyio.NpzFile) or "header" not in archive.files:
        raise InputError(f"{path}: not a star catalogue (no header)")
    header = json.loads(archive["header"].tobytes())
    if not isinstance(header, dict) or header.get("schema") != SCHEMA:
        raise InputError(f"{path}: not a star catalogue (schema {SCHEMA!r} expected)")
    version = header.get("version")
    if version != VERSION:
        raise InputError(f"{path}: schema version {version!r}, this version reads {VERSION}")
    return header


def _problems(columns: dict[str, NDArray[Any]], header: dict[str, Any]) -> list[str]:
    """Return what is wrong with the columns, the first few."""
    rows = len(columns["star_id"]) if columns["star_id"].ndim == 1 else -1
    for name, dtype in _STORED.items():
        shape = (rows, 3) if name in _VECTORS else (rows,)
        if columns[name].shape != shape or columns[name].dtype != np.dtype(dtype):
            return [f"column {name} is not {dtype} of shape {shape}"]
    if _sha256(columns) != header.get("sha256"):
        return ["content differs from its SHA-256: damaged or altered"]
    if rows == 0:
        return ["the catalogue holds no stars"]
    problems = [
        f"column {name} has values that are not finite"
        for name in ("direction", "motion", "parallax", "magnitude")
        if not np.isfinite(columns[name]).all()
    ]
    norm = np.linalg.norm(columns["direction"], axis=1)
    if not problems and np.abs(norm - 1.0).max() > _UNIT_TOLERANCE:
        problems.append("column direction has vectors that are not unit vectors")
    return problems


def _from_stored(columns: dict[str, NDArray[Any]], provenance: dict[str, Any]) -> StarCatalogue:
    native = {
        name: columns[name].astype(np.float64 if np.dtype(dtype).kind == "f" else dtype[1:])
        for name, dtype in _STORED.items()
        if name != "source"
    }
    return StarCatalogue(**native, source=columns["source"].astype("U1"), provenance=provenance)
