"""Build the upload directory ``serial-NNNN`` behind the gates; all of it or nothing."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stcal.atomic import TEMPORARY_PREFIX, locked, write_bytes
from stcal.calibration import Calibration, canonical_json, load, sha256_of
from stcal.config import SensorConfig
from stcal.errors import GateRefusalError, InputError
from stcal.uplink import decode, encode, manifest
from stcal.uplink.gates import Candidate, Finding, judge, not_finite, refusals
from stcal.uplink.held_out import at, is_number
from stcal.uplink.tables import Checked, encode_checked
from stcal.uplink.target import Target
from stcal.uplink.verify import Difference, verify_dump

ROLLBACK = "rollback/"


@dataclass(frozen=True)
class Evidence:
    """What stands behind an upload beside the two calibrations.

    Attributes
    ----------
    validation : the document of a validation of the two, or None
    config, on_disk : of the sensor, as the store has them (``gates.Candidate``), or None
    target : how the flight software holds a calibration, with its file, or None
    readback : a dump of the table on board, or None
    overrides : gate -> why its refusal doesn't count
    """

    validation: Mapping[str, Any] | None = None
    config: SensorConfig | None = None
    on_disk: Mapping[str, str] | None = None
    target: tuple[Target, bytes] | None = None
    readback: bytes | None = None
    overrides: Mapping[str, str] | None = None


@dataclass(frozen=True)
class Built:
    """An upload that passed: where it is, its manifest, and whether it was there already."""

    folder: Path
    calibration: Calibration
    parent: Calibration
    manifest: dict[str, Any]
    existed: bool


def build(
    calibration_path: Path,
    parent_path: Path,
    out: Path,
    evidence: Evidence,
    report: Callable[[Mapping[str, Any]], str],
) -> Built:
    """Write ``out/serial-NNNN``: calibration, tables of the target, rollback, report, manifest.

    Parameters
    ----------
    calibration_path, parent_path : the fitted calibration file and the one on board
    report : makes the HTML report of the manifest

    Raises
    ------
    GateRefusalError
        With every reason of every gate that isn't overridden; nothing is left behind.
    InputError
        When a file cannot be read, or ``out`` is not a directory.
    """
    _refuse(_all_not_finite(calibration_path, parent_path, evidence.validation), {})
    new, old = load(calibration_path), load(parent_path)
    files, table = _target_files(new, old, evidence)
    candidate = Candidate(
        calibration=new,
        sha256=sha256_of(calibration_path),
        parent=old,
        parent_sha256=sha256_of(parent_path),
        validation=evidence.validation,
        config=evidence.config,
        on_disk=evidence.on_disk,
        readback=_readback(files, evidence),
        table=table,
    )
    found, overrides = judge(candidate), dict(evidence.overrides or {})
    _refuse(refusals(found, overrides), found)
    files = _own_files(new, old) | files
    _refuse(mismatches(files, new, old), found)
    document = manifest.describe(candidate, files, found, overrides, evidence.target)
    page = report(document).encode("utf-8")
    files[manifest.REPORT] = page
    document["files"][manifest.REPORT] = manifest.file_facts(page)
    files[manifest.NAME] = canonical_json(document).encode("utf-8")
    folder = out / f"serial-{new.serial:04d}"
    existed = _place(files, out, folder)
    return Built(folder, new, old, document, existed)


def _own_files(new: Calibration, old: Calibration) -> dict[str, bytes]:
    """The canonical calibration and parameter table, and the calibration to roll back to."""
    return {
        encode.CALIBRATION_FILE: encode.encode_calibration(new),
        encode.TABLE_FILE: encode.encode_table(new, old),
        ROLLBACK + encode.CALIBRATION_FILE: encode.encode_calibration(old),
    }


def _target_files(
    new: Calibration, old: Calibration, evidence: Evidence
) -> tuple[dict[str, bytes], Checked | None]:
    """Encode the new calibration and its parent for the target, and decode both again."""
    if evidence.target is None:
        return {}, None
    target, source = evidence.target
    fitted = at(new.quality, "rms_urad", "fitted")
    limit = float(fitted) if is_number(fitted) else None
    files, checked = encode_checked(new, target, limit)
    back, checked_back = encode_checked(old, target, limit)
    reasons = checked.reasons + [f"rollback: {reason}" for reason in checked_back.reasons]
    rollback = {ROLLBACK + name: content for name, content in back.items()}
    figures = checked.figures | {"rollback": checked_back.figures}
    return {**files, manifest.TARGET: source, **rollback}, Checked(reasons, figures)


def _readback(files: Mapping[str, bytes], evidence: Evidence) -> list[Difference] | None:
    """Compare a dump of the table on board with the parent's encoding."""
    if evidence.readback is None or evidence.target is None:
        return None
    built = {
        name.removeprefix(ROLLBACK): content
        for name, content in files.items()
        if name.startswith(ROLLBACK)
    }
    return compare_dump(evidence.readback, built, evidence.target[0])


def compare_dump(dump: bytes, built: Mapping[str, bytes], target: Target) -> list[Difference]:
    """Return how a dump departs from the built binary files: from the one of its own form.

    Raises
    ------
    InputError
        When it is a damaged file, or there is no file of its form.
    """
    error = InputError("no binary table was built to compare with")
    for name in manifest.binary_files(built):
        try:
            return verify_dump(dump, built[name], target)
        except InputError as wrong:
            error = wrong
    raise error


def mismatches(files: dict[str, bytes], new: Calibration, old: Calibration) -> list[str]:
    """Decode both files independently and return every bit that is not as it should be."""
    try:
        calibration = decode.decode_calibration(files[encode.CALIBRATION_FILE])
        table = decode.decode_table(files[encode.TABLE_FILE])
    except decode.DecodeError as error:
        return [str(error)]
    values, parents = _values(new), _values(old)
    names = new.camera.parameter_names
    sds = encode.standard_deviations(new)
    changes = {name: value - parents[name] for name, value in values.items()}
    lines = []
    for what, found in (("calibration file", calibration), ("table", table)):
        lines += decode.differences(what, found.texts, _texts(new))
        lines += decode.differences(what, found.values, values)
    lines += decode.differences("covariance", calibration.covariance, _covariance(new))
    given = {name: sd for name, sd in zip(names, sds, strict=True) if sd is not None}
    lines += decode.differences("table sd", table.sds, given)
    lines += decode.differences("table parent", table.parents, parents)
    relatives = {name: changes[name] / sd for name, sd in given.items() if sd != 0.0}
    lines += decode.differences("table change", table.changes, changes)
    return lines + decode.differences("table change_sd", table.relatives, relatives)


def _all_not_finite(new: Path, parent: Path, validation: Mapping[str, Any] | None) -> list[str]:
    """Find NaN and infinity, which the JSON reader lets pass, before anything else is read."""
    judged = [f"validation: {line}" for line in not_finite(validation)]
    return _not_finite(new) + [f"parent: {line}" for line in _not_finite(parent)] + judged


def _not_finite(path: Path) -> list[str]:
    try:
        return list(not_finite(json.loads(path.read_bytes())))
    except (OSError, ValueError, RecursionError):
        return []  # load() says what is wrong with the file


def _refuse(reasons: list[str], found: Mapping[str, Finding]) -> None:
    if reasons:
        error = GateRefusalError("upload refused: " + "; ".join(reasons))
        gates = manifest.gate_facts(found, {}) if found else {}
        error.document = {"accepted": False, "reasons": reasons, "gates": gates}
        raise error


def _place(files: dict[str, bytes], out: Path, folder: Path) -> bool:
    """Move the files to their folder in one step; return whether equal ones were there."""
    if folder.exists() or folder.is_symlink():
        _refuse(_conflicts(files, folder), {})
        return True
    try:
        out.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise InputError(f"{out}: not a directory") from None
    try:
        with locked(out):
            return _place_locked(files, out, folder)
    except BlockingIOError:
        raise InputError(f"{out}: another process is building here; wait for its end") from None


def _place_locked(files: dict[str, bytes], out: Path, folder: Path) -> bool:
    temporary = Path(tempfile.mkdtemp(prefix=TEMPORARY_PREFIX, dir=out))
    try:
        for name, content in files.items():
            write_bytes(temporary / name, content)
        temporary.chmod(out.stat().st_mode & 0o777)
        try:
            temporary.rename(folder)
        except OSError:
            # Another build came first.
            if not folder.exists():
                raise
            _refuse(_conflicts(files, folder), {})
            return True
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return False


def _conflicts(files: dict[str, bytes], folder: Path) -> list[str]:
    if not folder.is_dir():
        return [f"{folder} exists and is not a directory"]
    return [
        f"{folder / name} exists with other content; an upload is never overwritten"
        for name, content in files.items()
        if not (folder / name).is_file() or (folder / name).read_bytes() != content
    ]


def _texts(calibration: Calibration) -> dict[str, str]:
    camera = calibration.camera
    return {
        "sensor_id": calibration.sensor_id,
        "serial": str(calibration.serial),
        "model": camera.model.name,
        "rows": str(camera.rows),
        "cols": str(camera.cols),
    }


def _values(calibration: Calibration) -> dict[str, float]:
    camera = calibration.camera
    values = {"pixel_size_m": camera.pixel_size_m}
    values |= dict(zip(camera.parameter_names, map(float, camera.parameters), strict=True))
    elements = np.ndenumerate(calibration.c_sd)
    return values | {f"c_sd_{i + 1}{j + 1}": float(value) for (i, j), value in elements}


def _covariance(calibration: Calibration) -> dict[tuple[str, str], float]:
    if calibration.covariance is None:
        return {}
    names = calibration.camera.parameter_names
    return {
        (names[i], names[j]): float(value)
        for (i, j), value in np.ndenumerate(calibration.covariance)
    }
