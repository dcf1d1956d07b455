from __future__ import annotations

import pytest
from target_cases import FOCAL_MM, GOLDEN, as_target, calibration, example, example_document

from stcal.uplink.decode import DecodeError
from stcal.uplink.formats.openc3 import encode
from stcal.uplink.formats.read_openc3 import Item, read_definition
from stcal.uplink.tables import check_all, encode_all


def encoded(calibration, target):
    return encode(target.openc3, calibration, target)


DEFINITION, BINARY = "ST16_CAL_def.txt", "ST16_CAL.bin"
# Table Manager of the openc3 package, 7.4.1, generates the golden binary of this definition.
GOLDEN_DEFINITION = (GOLDEN / DEFINITION).read_bytes()


def test_golden_files() -> None:
    files = encoded(calibration(), example())
    assert files[DEFINITION] == GOLDEN_DEFINITION
    assert files[BINARY] == (GOLDEN / BINARY).read_bytes()


def test_the_binary_is_the_structure_of_the_cfe_table() -> None:
    assert (GOLDEN / BINARY).read_bytes() == (GOLDEN / "st16_cal.tbl").read_bytes()[116:]


def test_what_the_definition_says() -> None:
    found = read_definition(GOLDEN_DEFINITION)
    assert found.table == "ST16_CALIBRATION"
    assert found.byte_order == "little"
    items = {item.name: item for item in found.items}
    assert items["VERSION"] == Item(
        "VERSION", 16, "UINT", 3, 3, 3, "constant", flags=("UNEDITABLE",)
    )
    focal = Item("FOCAL_LENGTH", 64, "FLOAT", 15.5, 16.5, FOCAL_MM, "f_m", "mm")
    assert items["FOCAL_LENGTH"] == focal
    row = items["ROW_0"]
    assert (row.lowest, row.highest) == (472 * 65536, 1472 * 65536)
    assert row.default == round(980.123 * 65536)
    assert row.description == "m0_px in counts of 1.52587890625e-05 px"
    assert items["SERIAL"].lowest is None
    assert items["PADDING_2"].flags == ("HIDDEN",)
    assert found.binary() == (GOLDEN / BINARY).read_bytes()


def test_offset_and_decimal_scale_are_told() -> None:
    document = example_document()
    row = next(f for f in document["field"] if f["name"] == "row_0")
    row.pop("fraction_bits")
    row |= {"scale": 0.001, "offset": 1.0, "minimum": 672.0004, "maximum": 1272.0006}
    target = as_target(document)
    item = next(
        i for i in read_definition(encoded(calibration(), target)[DEFINITION]).items
        if i.name == "ROW_0"
    )  # fmt: skip
    assert item.description == "m0_px + 1.0 px in counts of 0.001 px"
    assert (item.lowest, item.highest) == (672001, 1272000)
    assert item.default == 981123
    files = encode_all(calibration(), target)
    assert check_all(files, calibration(), target, 60.0).reasons == []


BROKEN = {
    "keyword": (b"TABLE", b"TABLA", "line 3"),
    "byte order": (b"LITTLE_ENDIAN", b"MIDDLE_ENDIAN", "line 3"),
    "item": (b"APPEND_PARAMETER", b"APPEND_PARAMETAR", "line 4"),
    "type": (b" FLOAT 15.5", b" FLOOT 15.5", "line 11"),
    "number": (b"16.01234567", b"16.o1234567", "line 11"),
    "number's form": (b" 15.5 ", b" 15.50 ", "15.50 is not written as 15.5"),
    "units": (b'"mm" "mm"', b'"mm" "nm"', "line 12"),
    "not ASCII": (b"padding", b"p\xe1dding", "is not ASCII"),
    "twice": (b"    UNEDITABLE\n", b"    UNEDITABLE\n    UNEDITABLE\n", "line 6"),
    "nothing after": (b"\n", b" ", "the last line has no end"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_the_reader_refuses(name: str) -> None:
    old, new, message = BROKEN[name]
    count = -1 if name == "nothing after" else 1
    broken = GOLDEN_DEFINITION.replace(old, new, count)
    assert broken != GOLDEN_DEFINITION
    with pytest.raises(DecodeError, match=message):
        read_definition(broken)


def test_a_default_beyond_its_item_is_refused() -> None:
    broken = GOLDEN_DEFINITION.replace(b'UINT 3 3 3 "', b'UINT 3 3 65536 "')
    with pytest.raises(DecodeError, match="default of VERSION"):
        read_definition(broken).binary()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b'"TILT_1"', b'"TILT_3"', "TILT_3"),
        (b"15.5 16.5", b"15.5 17.5", "17.5"),
        (b'"ROWS" 16 UINT', b'"ROWS" 16 INT', "('ROWS', 16, 'INT'"),
        (b"16.012345670000002", b"16.0123", "default of FOCAL_LENGTH is 16.0123, the binary has"),
        (b'"ST16_CALIBRATION"', b'"ST17_CALIBRATION"', "table is 'ST17_CALIBRATION'"),
    ],
)
def test_the_comparison_finds_a_wrong_definition(old: bytes, new: bytes, message: str) -> None:
    assert old in GOLDEN_DEFINITION
    files = encode_all(calibration(), example())
    files[DEFINITION] = GOLDEN_DEFINITION.replace(old, new)
    reasons = check_all(files, calibration(), example(), 60.0).reasons
    decoded = [line for line in reasons if line.startswith("openc3: definition: ")]
    assert any(message in line for line in decoded)
