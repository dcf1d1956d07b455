"""Encoder of a NASA cFE table image: file header, table header, structure.

CFE_FS_Header_t and CFE_TBL_File_Hdr_t of cFE (cfe_fs_filedef.h, cfe_tbl_filedef.h), both
big-endian on every processor.  The file has no checksum: the load service reports the CRC-16/ARC
of the structure.
"""

from __future__ import annotations

import struct

import numpy as np

from stcal.calibration import Calibration
from stcal.times import parse_utc, utc_from_tai_ns
from stcal.uplink.formats.payload import structure
from stcal.uplink.formats.words import EncodeError
from stcal.uplink.target import Target
from stcal.uplink.target_sections import CfeSection

_FILE_HEADER = struct.Struct(">8I32s")
_TABLE_HEADER = struct.Struct(">3I40s")
_CONTENT_TYPE = 0x63464531  # "cFE1"
_TABLE_IMAGE = 8


def encode(section: CfeSection, calibration: Calibration, target: Target) -> dict[str, bytes]:
    """Return the table image by its file name."""
    payload = structure(calibration, target)
    seconds, subseconds = header_time(calibration, section)
    header = _FILE_HEADER.pack(
        _CONTENT_TYPE, _TABLE_IMAGE, _FILE_HEADER.size, section.spacecraft_id,
        section.processor_id, section.application_id, seconds, subseconds,
        section.description.encode("ascii"),
    )  # fmt: skip
    table = _TABLE_HEADER.pack(0, 0, len(payload), section.table_name.encode("ascii"))
    return {section.file: header + table + payload}


def header_time(calibration: Calibration, section: CfeSection) -> tuple[int, int]:
    """Return seconds and 2^-32 seconds from the epoch to the end of the fitted data.

    The file's own time would make its bytes differ from build to build.  Zero without an epoch, or
    for a calibration that was not fitted.

    Raises
    ------
    EncodeError
        When the end of the data is no time, or one that the header cannot hold.
    """
    end = calibration.provenance.get("to")
    if section.epoch_utc is None or end is None:
        return 0, 0
    try:
        times = np.array([parse_utc(section.epoch_utc), parse_utc(str(end))])
    except ValueError as error:
        raise EncodeError([f"{section.file}: provenance.to is {end!r}: {error}"]) from None
    if section.time_scale == "utc":
        times = utc_from_tai_ns(times)
    seconds, ns = divmod(int(times[1] - times[0]), 10**9)
    if not 0 <= seconds < 2**32:
        raise EncodeError([f"{section.file}: provenance.to {end} is not in the header's 136 years"])
    return seconds, (ns << 32) // 10**9
