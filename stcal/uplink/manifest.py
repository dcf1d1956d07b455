"""The manifest of an upload: what it holds, where it came from, and which gates it passed."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from stcal.calibration import sha256_of
from stcal.errors import InputError
from stcal.reading import read_json_object
from stcal.uplink.gates import Candidate, Finding
from stcal.uplink.target import Target, target_sha256
from stcal.version import __version__

SCHEMA = "stcal.upload/1"
NAME, REPORT, TARGET = "manifest.json", "report.html", "target.toml"
APPROVAL = "approval.json"
# Binary tables: the cFE's first, whose reported CRC is that of the payload.
_BINARY = (".tbl", ".bin", ".dat")


def describe(
    candidate: Candidate,
    files: Mapping[str, bytes],
    found: Mapping[str, Finding],
    overrides: Mapping[str, str],
    target: tuple[Target, bytes] | None,
) -> dict[str, Any]:
    """Return the manifest's content; equal inputs give equal bytes."""
    new, old, span = candidate.calibration, candidate.parent, candidate.calibration.provenance
    return {
        "schema": SCHEMA,
        "software": f"stcal {__version__}",
        "sensor_id": new.sensor_id,
        "serial": new.serial,
        "parent": {"serial": old.serial, "sha256": candidate.parent_sha256},
        "calibration_sha256": candidate.sha256,
        "data": {
            "fit": {key: span.get(key) for key in ("from", "to")},
            "validation": (candidate.validation or {}).get("span"),
        },
        "provenance": dict(span),
        "target": None if target is None else _target(target[0]),
        "crc16_arc": {} if candidate.table is None else candidate.table.figures.get("crc16_arc"),
        "files": {name: file_facts(files[name]) for name in sorted(files)},
        "gates": gate_facts(found, overrides),
        "overrides": dict(sorted(overrides.items())),
    }


def _target(target: Target) -> dict[str, Any]:
    return {"name": target.name, "sha256": target_sha256(target)}


def file_facts(content: bytes) -> dict[str, Any]:
    """Return hash and size of a file."""
    return {"sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content)}


def gate_facts(found: Mapping[str, Finding], overrides: Mapping[str, str]) -> dict[str, Any]:
    """Return what each gate found: passed, refused or overridden, reasons and figures."""
    return {
        name: {
            "passed": not finding.reasons,
            "reasons": list(finding.reasons),
            "override": overrides.get(name) if finding.reasons else None,
            "figures": finding.figures,
        }
        for name, finding in found.items()
    }


def binary_files(names: Iterable[str]) -> list[str]:
    """Return the binary tables among an upload's files, the cFE's first, without the rollback's."""
    own = [name for name in names if "/" not in name]
    return [name for ending in _BINARY for name in sorted(own) if name.endswith(ending)]


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read an upload's manifest and check that every file is as it was built.

    Raises
    ------
    InputError
        Naming the first file that is missing, changed, not in the manifest, or not in its form.
    """
    path = folder / NAME
    document = read_json_object(path)
    files = document.get("files")
    if document.get("schema") != SCHEMA or not isinstance(files, dict):
        raise InputError(f"{path}: not an upload's manifest (schema {SCHEMA})")
    for name, facts in files.items():
        file = folder / name
        if not isinstance(facts, dict) or ".." in Path(name).parts or Path(name).is_absolute():
            raise InputError(f"{path}: the entry of {name!r} is damaged")
        try:
            # A pipe or a device may never end.
            if file.exists() and not file.is_file():
                raise InputError(f"{file}: is not a file")
            found = sha256_of(file)
        except OSError as error:
            raise InputError(f"{file}: cannot be read: {error.strerror}") from None
        except ValueError:  # a NUL character
            raise InputError(f"{path}: the entry of {name!r} is damaged") from None
        if found != facts.get("sha256"):
            raise InputError(
                f"{file}: is not what was built: SHA-256 {found}, the manifest has "
                f"{facts.get('sha256')}"
            )
    there = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if not p.is_dir()}
    unknown = sorted(there - set(files) - {NAME, APPROVAL})
    if unknown:
        # It would be sent with the others, and no gate has seen it.
        raise InputError(f"{folder / unknown[0]}: is not in the manifest")
    return document
