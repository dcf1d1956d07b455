"""Build the upload directory ``serial-NNNN`` behind the gates; all of it or nothing."""

from __future__ import annotations

import json
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stcal.atomic import TEMPORARY_PREFIX, write_bytes
from stcal.calibration import Calibration, load, sha256_of
from stcal.errors import GateRefusalError, InputError
from stcal.uplink import decode, encode
from stcal.uplink.gates import Candidate, not_finite, refusals


@dataclass(frozen=True)
class Built:
    """An upload that passed: where it is, and whether it was there already."""

    folder: Path
    calibration: Calibration
    parent: Calibration
    sha256: dict[str, str]
    existed: bool


def build(
    calibration_path: Path, parent_path: Path, out: Path, validation: dict[str, Any] | None = None
) -> Built:
    """Write ``out/serial-NNNN`` with the calibration file and the parameter table.

    Parameters
    ----------
    calibration_path, parent_path : the fitted calibration file and the one on board
    validation : the document of a validation of these two files, or None

    Raises
    ------
    GateRefusalError
        With every reason; nothing is left behind.
    InputError
        When a file cannot be read, or ``out`` is not a directory.
    """
    _refuse(_not_finite(calibration_path))
    candidate = Candidate(
        calibration=load(calibration_path),
        sha256=sha256_of(calibration_path),
        parent=load(parent_path),
        parent_sha256=sha256_of(parent_path),
        validation=validation,
    )
    _refuse(refusals(candidate))
    new, old = candidate.calibration, candidate.parent
    files = {
        encode.CALIBRATION_FILE: encode.encode_calibration(new),
        encode.TABLE_FILE: encode.encode_table(new, old),
    }
    _refuse(mismatches(files, new, old))
    folder = out / f"serial-{new.serial:04d}"
    existed = _place(files, out, folder)
    written = {name: sha256_of(folder / name) for name in files}
    return Built(folder, new, old, written, existed)


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


def _not_finite(path: Path) -> list[str]:
    """Find NaN and infinity, which the JSON reader lets pass, before anything else is read."""
    try:
        return list(not_finite(json.loads(path.read_bytes())))
    except (OSError, ValueError, RecursionError):
        return []  # load() says what is wrong with the file


def _refuse(reasons: list[str]) -> None:
    if reasons:
        error = GateRefusalError("upload refused: " + "; ".join(reasons))
        error.document = {"accepted": False, "reasons": reasons}
        raise error


def _place(files: dict[str, bytes], out: Path, folder: Path) -> bool:
    """Move the files to their folder in one step; return whether equal ones were there."""
    if folder.exists() or folder.is_symlink():
        _refuse(_conflicts(files, folder))
        return True
    try:
        out.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise InputError(f"{out}: not a directory") from None
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
            _refuse(_conflicts(files, folder))
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
