"""Approval of an upload: a name and a time, bound to the manifest by its hash."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from stcal.atomic import write_text
from stcal.calibration import canonical_json, sha256_of
from stcal.errors import GateRefusalError, InputError
from stcal.reading import read_json_object
from stcal.uplink.manifest import APPROVAL, NAME, read_manifest

SCHEMA = "stcal.approval/1"


@dataclass(frozen=True)
class Approval:
    """Who approved which manifest, and when."""

    name: str
    time_utc: str
    manifest_sha256: str


def approve(folder: Path, name: str, time_utc: str) -> Approval:
    """Check that an upload is what was built, and write its approval.

    Raises
    ------
    InputError
        A file of the upload is missing or changed, or the name is empty or cannot be printed.
    GateRefusalError
        The upload has an approval by another name, or of another manifest.
    """
    if not name.strip() or not name.isprintable():
        raise InputError(f"{name!r} is not a name that can be printed")
    read_manifest(folder)
    approval = Approval(name, time_utc, sha256_of(folder / NAME))
    path = folder / APPROVAL
    if path.exists():
        return _again(path, approval)
    write_text(path, canonical_json({"schema": SCHEMA, **asdict(approval)}))
    return approval


def _again(path: Path, approval: Approval) -> Approval:
    """Return the approval that is there when it is the same but for its time."""
    old = _read(path)
    if (old.name, old.manifest_sha256) != (approval.name, approval.manifest_sha256):
        raise GateRefusalError(
            f"{path}: approved by {old.name} at {old.time_utc}, manifest {old.manifest_sha256}; "
            "an approval is never overwritten"
        )
    return old


def _read(path: Path) -> Approval:
    found = read_json_object(path)
    return Approval(*(str(found.get(key)) for key in ("name", "time_utc", "manifest_sha256")))


def approval_of(folder: Path) -> Approval | None:
    """Return the approval of an upload, None when there is none or it is of another manifest."""
    path = folder / APPROVAL
    if not path.exists():
        return None
    approval = _read(path)
    return approval if approval.manifest_sha256 == sha256_of(folder / NAME) else None
