"""What flies against what was built."""

from __future__ import annotations

from pathlib import Path

from stcal.errors import InputError
from stcal.uplink.build import compare_dump
from stcal.uplink.manifest import NAME, TARGET, binary_files, read_manifest
from stcal.uplink.target import load_target
from stcal.uplink.verify import Difference, verify_crc


def compare_with_upload(
    folder: Path, dump: bytes | None, reported_crc: int | None
) -> list[Difference]:
    """Return how a memory dump, or a reported CRC-16/ARC, departs from an upload.

    Raises
    ------
    InputError
        The upload is changed or was built without a target, or the dump is damaged.
    """
    files = read_manifest(folder)["files"]
    names = binary_files(files)
    if TARGET not in files or not names:
        raise InputError(f"{folder / NAME}: built without a target's tables: nothing to compare")
    target = load_target(folder / TARGET)
    if dump is not None:
        return compare_dump(dump, {name: (folder / name).read_bytes() for name in names}, target)
    if reported_crc is None:
        raise InputError("neither a dump nor a CRC to compare")
    return verify_crc(reported_crc, (folder / names[0]).read_bytes(), target)
