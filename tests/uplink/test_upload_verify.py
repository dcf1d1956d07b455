from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from target_cases import as_target, calibration, example, example_document

from stcal.calibration import Calibration
from stcal.cameras import CAMERAS
from stcal.errors import InputError
from stcal.uplink.crc import crc16_arc
from stcal.uplink.formats.words import layout
from stcal.uplink.tables import encode_all
from stcal.uplink.verify import calibration_from_dump, verify_crc, verify_dump

FILES = encode_all(calibration(), example())
TABLE, PARAMETER, BINARY = (FILES[f"{n}"] for n in ("st16_cal.tbl", "st16_cal.dat", "ST16_CAL.bin"))


def changed(content: bytes, offset: int, new: bytes) -> bytes:
    return content[:offset] + new + content[offset + len(new) :]


def test_equal_dumps_do_not_differ() -> None:
    for dump in (TABLE, BINARY):
        for built in (TABLE, BINARY):
            assert verify_dump(dump, built, example()) == []
    assert verify_dump(PARAMETER, PARAMETER, example()) == []


def test_first_differing_field_comes_first_with_both_values() -> None:
    offsets = {slot.label: slot.offset for slot in layout(example())[0]}
    dump = changed(BINARY, offsets["tilt_2"], struct.pack("<d", 0.5))
    dump = changed(dump, offsets["serial"], struct.pack("<I", 6))
    dump = changed(changed(dump, 2, b"\x44"), 140, b"\x55")
    gap, first, second, third = verify_dump(dump, TABLE, example())
    assert (gap.field, gap.offset, gap.found) == ("padding", 2, "0x44")
    assert (first.field, first.offset) == ("serial", 4)
    assert (first.built, first.found) == ("7 (0x00000007)", "6 (0x00000006)")
    assert second.field == "tilt_2"
    assert second.built.startswith("-0.0025 (0x")
    assert second.found == "0.5 (0x3fe0000000000000)"
    assert (third.field, third.offset, third.built, third.found) == ("padding", 140, "0x00", "0x55")


def test_every_flipped_bit_is_one_difference_of_its_field() -> None:
    spans = {
        s.label: (s.offset, int(s.field.word[-2:].lstrip("t")) // 8) for s in layout(example())[0]
    }
    for bit in range(8 * len(BINARY)):
        byte = bit // 8
        dump = changed(BINARY, byte, bytes([BINARY[byte] ^ (1 << bit % 8)]))
        (difference,) = verify_dump(dump, BINARY, example())
        owner = [k for k, (start, size) in spans.items() if start <= byte < start + size]
        assert difference.field == (owner[0] if owner else "padding")
        assert difference.built != difference.found


def test_nan_on_board_is_shown() -> None:
    dump = changed(BINARY, 8, struct.pack("<d", np.nan))
    (difference,) = verify_dump(dump, BINARY, example())
    assert difference.field == "focal_length"
    assert difference.found.startswith("nan")


def test_short_and_long_dumps() -> None:
    (short,) = verify_dump(BINARY[:100], BINARY, example())
    assert (short.field, short.built, short.found) == ("length", "144 bytes", "100 bytes")
    (long,) = verify_dump(BINARY + bytes(4), BINARY, example())
    assert long.found == "148 bytes"
    with pytest.raises(InputError, match="dump: is empty"):
        verify_dump(b"", BINARY, example())


def test_headers_of_a_dumped_table() -> None:
    # Table services write the time of the dump and a description of their own.
    own = changed(
        changed(TABLE, 24, b"\1\2\3\4\5\6\7\x08"), 32, b"Table dump image".ljust(32, b"\0")
    )
    assert verify_dump(own, TABLE, example()) == []
    other = changed(own, 76, b"XX_APP")
    (difference,) = verify_dump(other, TABLE, example())
    assert difference.field == "cFE header: table name"
    assert (difference.built, difference.found) == ("ST_APP.CalTable", "XX_APP.CalTable")
    with pytest.raises(InputError, match="dump: cFE header: subtype is 9"):
        verify_dump(changed(TABLE, 4, struct.pack(">I", 9)), TABLE, example())


def test_f_prime_dumps() -> None:
    import zlib

    records = changed(PARAMETER[4:], 9 + 2, struct.pack(">I", 6))
    dump = struct.pack(">I", zlib.crc32(records) ^ 0xFFFFFFFF) + records
    (difference,) = verify_dump(dump, PARAMETER, example())
    assert (difference.field, difference.built[0], difference.found[0]) == ("serial", "7", "6")
    with pytest.raises(InputError, match=r"compare it with the built \.dat"):
        verify_dump(dump, TABLE, example())
    with pytest.raises(InputError, match="dump: F Prime file: CRC is"):
        verify_dump(changed(PARAMETER, 20, b"\xff"), PARAMETER, example())
    records = changed(PARAMETER[4:], 8, b"\x36")
    other = struct.pack(">I", zlib.crc32(records) ^ 0xFFFFFFFF) + records
    with pytest.raises(InputError, match="parameter id is 0x1236"):
        verify_dump(other, PARAMETER, example())


def test_reported_crc() -> None:
    crc = crc16_arc(BINARY)
    assert verify_crc(crc, TABLE, example()) == []
    assert verify_crc(crc, BINARY, example()) == []
    (difference,) = verify_crc(crc ^ 1, TABLE, example())
    assert difference.built == f"0x{crc:04X}"
    assert difference.found == f"0x{crc ^ 1:04X}"


@pytest.mark.parametrize("dump", [TABLE, PARAMETER, BINARY], ids=["cfe", "fprime", "memory"])
def test_calibration_of_a_dump(dump: bytes) -> None:
    like = calibration(serial=1, f_m=0.016, a1_rad=0.0)
    found = calibration_from_dump(dump, example(), like)
    assert found.serial == 7
    assert found.sensor_id == "ST16-1"
    assert found.camera.value("f_m") == pytest.approx(0.01601234567, rel=1e-15)
    assert found.camera.value("a1_rad") == 1e-3
    assert (found.c_sd == calibration().c_sd).all()
    assert found.covariance is None
    assert found.provenance == {}


def test_memory_may_hold_anything_in_its_padding() -> None:
    found = calibration_from_dump(changed(BINARY, 2, b"\xaa\xbb"), example(), calibration())
    assert found.serial == 7


def test_a_dump_of_something_else_is_bad_input() -> None:
    with pytest.raises(InputError, match="dump: the structure has 140 bytes, the target's has 144"):
        calibration_from_dump(BINARY[:140], example(), calibration())
    with pytest.raises(InputError, match="dump: version is 4, the target's is 3"):
        calibration_from_dump(changed(BINARY, 0, b"\4"), example(), calibration())
    with pytest.raises(InputError, match="dump: focal_length is nan"):
        calibration_from_dump(
            changed(BINARY, 8, struct.pack("<d", np.nan)), example(), calibration()
        )


def test_a_dump_is_read_for_the_camera_model_of_the_target() -> None:
    like, model = calibration(), CAMERAS["pixel-radial"]
    camera = replace(like.camera, model=model, parameters=model.undistorted(0.016, 972.0, 1296.0))
    with pytest.raises(InputError, match="computes with 'wang', not 'pixel-radial'"):
        calibration_from_dump(BINARY, example(), replace(like, camera=camera))


def test_numbers_that_are_no_calibration_are_bad_input() -> None:
    zeros = struct.pack("<HxxI", 3, 7) + bytes(136)
    with pytest.raises(InputError, match=r"alignment is no rotation \(orthonormal to 1\)"):
        calibration_from_dump(zeros, example(), calibration())
    offsets = {slot.label: slot.offset for slot in layout(example())[0]}
    mirrored = changed(
        BINARY, offsets["alignment_11"], struct.pack("<9d", *np.diag([-1, 1, 1]).flat)
    )
    with pytest.raises(InputError, match="alignment is no rotation"):
        calibration_from_dump(mirrored, example(), calibration())
    twice = np.ravel(2.0 * np.eye(3))
    doubled = changed(BINARY, offsets["alignment_11"], struct.pack("<9d", *twice))
    with pytest.raises(InputError, match=r"alignment is no rotation \(orthonormal to 3\)"):
        calibration_from_dump(doubled, example(), calibration())
    negative = changed(BINARY, offsets["focal_length"], struct.pack("<d", -16.0))
    with pytest.raises(InputError, match=r"focal length is -0\.016 m"):
        calibration_from_dump(negative, example(), calibration())


def outcome(check: Callable[[], object]) -> object:
    """Return what a check finds, or what it says of bad input."""
    try:
        return check()
    except InputError as error:
        return str(error)


@settings(max_examples=150, deadline=None)
@given(st.sampled_from([TABLE, PARAMETER, BINARY]), st.data())
def test_damaged_dumps_differ_or_are_bad_input(built: bytes, data: st.DataObject) -> None:
    start = data.draw(st.integers(0, len(built)))
    left_out = data.draw(st.integers(0, 30))
    dump = built[:start] + data.draw(st.binary(max_size=30)) + built[start + left_out :]
    found = outcome(lambda: verify_dump(dump, built, example()))
    if found == []:
        # Nothing but a table image's own time and description.
        own = range(24, 64) if built is TABLE else range(0)
        assert len(dump) == len(built)
        assert all(k in own for k in range(len(built)) if dump[k] != built[k])
    read = outcome(lambda: calibration_from_dump(dump, example(), calibration()))
    assert isinstance(read, Calibration) or "dump" in str(read)


def test_quaternions_come_back() -> None:
    document = example_document()
    document["table"].pop("size_bytes")
    item = next(f for f in document["field"] if f["name"] == "alignment")
    item |= {"value": "q_ds", "order": "wxyz"}
    target = as_target(document)
    dump = encode_all(calibration(), target)["st16_cal.tbl"]
    found = calibration_from_dump(dump, target, calibration(c_sd=np.eye(3)))
    np.testing.assert_allclose(found.c_sd, calibration().c_sd, atol=1e-15)
