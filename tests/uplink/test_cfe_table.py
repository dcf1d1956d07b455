from __future__ import annotations

import ctypes
import struct
from typing import Any

import pytest
from target_cases import FOCAL_MM, GOLDEN, as_target, calibration, example, example_document

from stcal.errors import ConfigError
from stcal.uplink.crc import crc16_arc, shown
from stcal.uplink.decode import DecodeError
from stcal.uplink.formats.cfe import encode
from stcal.uplink.formats.payload import structure
from stcal.uplink.formats.read_cfe import read_image
from stcal.uplink.formats.read_words import places
from stcal.uplink.formats.words import EncodeError, layout
from stcal.uplink.tables import encode_all


def encoded(calibration, target):
    return encode(target.cfe, calibration, target)


NAME = "st16_cal.tbl"
CTYPES = {
    "float32": ctypes.c_float, "float64": ctypes.c_double,
    "int8": ctypes.c_int8, "int16": ctypes.c_int16, "int32": ctypes.c_int32,
    "int64": ctypes.c_int64, "uint8": ctypes.c_uint8, "uint16": ctypes.c_uint16,
    "uint32": ctypes.c_uint32, "uint64": ctypes.c_uint64,
}  # fmt: skip
SIZES = {"c_sd": 9, "q_sd": 4, "q_ds": 4}


def c_structure(document: dict[str, Any]) -> Any:
    """Return the structure as ctypes lays it out: what a C compiler does."""
    members = []
    for item in document["field"]:
        count = item.get("count", SIZES.get(item["value"]))
        word: Any = CTYPES[item.get("word", "uint8")]
        members.append((item["name"], word * count if count else word))
    order = document["table"]["byte_order"]
    base: Any = ctypes.LittleEndianStructure if order == "little" else ctypes.BigEndianStructure
    content = {"_pack_": document["table"].get("alignment", 8), "_fields_": members}
    return type("CalTable", (base,), content)


@pytest.mark.parametrize("byte_order", ["little", "big"])
@pytest.mark.parametrize("alignment", [1, 2, 4, 8])
def test_layout_is_that_of_c(byte_order: str, alignment: int) -> None:
    document = example_document()
    document["table"] = {"byte_order": byte_order, "alignment": alignment}
    target, given = as_target(document), calibration()
    kind = c_structure(document)
    slots, size = layout(target)
    assert size == ctypes.sizeof(kind)
    assert places(target)[1] == size
    offsets = {s.label: s.offset for s in slots}
    assert offsets == {p.label: p.offset for p in places(target)[0]}
    for label in ("serial", "focal_length", "row_0", "radial_4", "tilt_1", "rows", "columns"):
        assert offsets[label] == getattr(kind, label).offset
    assert offsets["alignment_11"] == kind.alignment.offset
    table = kind.from_buffer_copy(structure(given, target))
    assert table.version == 3
    assert table.serial == 7
    assert table.focal_length == FOCAL_MM
    assert table.row_0 == round(980.123 * 2**16)
    assert table.radial_2 == struct.unpack("f", struct.pack("f", 1.2345e-3))[0]
    assert list(table.alignment) == given.c_sd.ravel().tolist()
    assert table.columns == 2592
    assert not any(table.spare)


def test_headers_byte_by_byte() -> None:
    content = encoded(calibration(), example())[NAME]
    # 2026-01-05T12:00:00.250Z: 16802 days and 12 h after the epoch, and 18 leap seconds since it.
    seconds = (46 * 365 + 12 - 5 + 4) * 86400 + 43200 + 18
    expected = [0x63464531, 8, 64, 0x42, 1, 0, seconds, 2**30]
    assert list(struct.unpack(">8I", content[:32])) == expected
    assert content[32:64] == b"ST-16 calibration".ljust(32, b"\0")
    assert struct.unpack(">3I", content[64:76]) == (0, 0, 144)
    assert content[76:116] == b"ST_APP.CalTable".ljust(40, b"\0")
    assert content[116:] == structure(calibration(), example())


def test_golden_file() -> None:
    assert encode_all(calibration(), example())[NAME] == (GOLDEN / NAME).read_bytes()


@pytest.mark.parametrize(("scale", "leap"), [("tai", 18), ("utc", 0)])
def test_time_scales(scale: str, leap: int) -> None:
    document = example_document()
    document["cfe"] |= {"time_scale": scale, "epoch_utc": "2000-01-01T12:00:00Z"}
    content = encoded(calibration(), as_target(document))[NAME]
    since_2000 = 26 * 365 + 7 + 4
    leaps = 0 if leap == 0 else 5  # 2006, 2009, 2012, 2015, 2017
    assert struct.unpack(">II", content[24:32]) == (since_2000 * 86400 + leaps, 2**30)


def test_a_calibration_that_was_not_fitted_has_no_time() -> None:
    content = encoded(calibration(provenance={}), example())[NAME]
    assert content[24:32] == bytes(8)


@pytest.mark.parametrize("end", ["1979-01-01T00:00:00Z", "2126-01-01T00:00:00Z", "yesterday", 7])
def test_a_time_that_the_header_cannot_hold_is_refused(end: object) -> None:
    with pytest.raises(EncodeError, match=r"st16_cal\.tbl: provenance\.to"):
        encode_all(calibration(provenance={"to": end}), example())


@pytest.mark.parametrize(
    ("offset", "byte", "message"),
    [
        (0, 0x64, "content type is 64464531"),
        (7, 9, "subtype is 9, not 8"),
        (11, 65, "length is 65, not 64"),
        (67, 1, "reserved is 1, not 0"),
        (71, 1, "offset is 1, not 0"),
        (75, 145, "bytes is 145, not 144"),
        (63, 65, "description .* does not end in NUL"),
        (32, 200, "description .* is not ASCII"),
        (115, 65, "table name .* does not end in NUL"),
    ],
)
def test_the_reader_refuses(offset: int, byte: int, message: str) -> None:
    content = bytearray((GOLDEN / NAME).read_bytes())
    content[offset] = byte
    with pytest.raises(DecodeError, match=message):
        read_image(bytes(content))


def test_the_reader_refuses_cut_files() -> None:
    content = (GOLDEN / NAME).read_bytes()
    with pytest.raises(DecodeError, match="bytes is 144, not 143"):
        read_image(content[:-1])
    with pytest.raises(DecodeError, match="116 bytes of headers, here are 100"):
        read_image(content[:100])


def test_crc_16_arc() -> None:
    assert crc16_arc(b"123456789") == 0xBB3D
    assert crc16_arc(b"") == 0
    assert crc16_arc(b"\x01") == 0xC0C1
    # Appended, least significant byte first, it leaves nothing.
    crc = crc16_arc((GOLDEN / NAME).read_bytes())
    assert crc16_arc((GOLDEN / NAME).read_bytes() + crc.to_bytes(2, "little")) == 0
    assert shown(0xAB) == "0x00AB"


def test_config_error_is_bad_input() -> None:
    assert ConfigError("x").exit_code == EncodeError(["x"]).exit_code == 3
