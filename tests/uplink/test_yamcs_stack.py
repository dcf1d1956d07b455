from __future__ import annotations

import json
from typing import Any

import pytest
from target_cases import FOCAL_MM, GOLDEN, as_target, calibration, example, example_document

from stcal.uplink.decode import DecodeError
from stcal.uplink.formats.read_yamcs import number_of_argument, read_stack
from stcal.uplink.formats.yamcs import encode
from stcal.uplink.tables import check_all, encode_all


def encoded(calibration, target):
    return encode(target.yamcs, calibration, target)


NAME = "st16_cal.ycs"


def test_golden_file() -> None:
    assert encoded(calibration(), example())[NAME] == (GOLDEN / NAME).read_bytes()


def test_what_the_stack_says() -> None:
    set_calibration, load = read_stack((GOLDEN / NAME).read_bytes())
    assert set_calibration.name == "/SAT/STARTRACKER/SET_CALIBRATION"
    assert set_calibration.comment == "ST16-1 serial 7, instance ops"
    assert set_calibration.acknowledgment == "Acknowledge_Sent"
    assert set_calibration.wait_ms == 1000
    values = dict(set_calibration.arguments)
    assert len(values) == len(set_calibration.arguments) == 21
    assert values["focal_length"] == FOCAL_MM
    assert values["row_0"] == round(980.123 * 65536)
    assert values["alignment_12"] == calibration().c_sd[0, 1]
    assert "spare" not in values
    assert load.name == "/SAT/CFE_TBL/LOAD"
    assert load.arguments == [("FILENAME", "/cf/st16_cal.tbl")]


def test_the_form_is_the_one_that_yamcs_reads() -> None:
    # Stack.fromJson of Yamcs: members by these names, numbers as JSON numbers.
    document = json.loads((GOLDEN / NAME).read_text())
    assert document["$schema"] == "https://yamcs.org/schema/command-stack.schema.json"
    command = document["commands"][0]
    assert list(command) == ["name", "comment", "extraOptions", "arguments", "advancement"]
    assert command["arguments"][0] == {"name": "version", "value": 3}
    assert command["advancement"] == {"acknowledgment": "Acknowledge_Sent", "wait": 1000}


def test_numbers_beyond_doubles_are_text() -> None:
    document = example_document()
    version = next(f for f in document["field"] if f["name"] == "version")
    document["table"].pop("size_bytes")
    version |= {"word": "uint64", "constant": 2**60 + 1}
    target = as_target(document)
    files = encode_all(calibration(), target)
    assert dict(read_stack(files[NAME])[0].arguments)["version"] == str(2**60 + 1)
    assert check_all(files, calibration(), target, 60.0).reasons == []


@pytest.mark.parametrize("value", ["1.5", "7", "9007199254740992", True, None, [1]])
def test_what_is_no_number(value: Any) -> None:
    with pytest.raises(DecodeError, match=r"is not a number|should not be text"):
        number_of_argument(value)
    assert number_of_argument("9007199254740993") == 2**53 + 1


BROKEN = {
    "not JSON": lambda text: text[:-3],
    "schema": lambda text: text.replace("command-stack", "command-stock"),
    "member": lambda text: text.replace('"extraOptions"', '"extraOption"'),
    "argument": lambda text: text.replace('"value": 3', '"valve": 3'),
    "advancement": lambda text: text.replace('"wait"', '"weight"'),
    "twice": lambda text: text.replace('"value": 3\n', '"value": 3, "value": 3\n'),
    "NaN": lambda text: text.replace('"value": 3\n', '"value": NaN\n'),
    "nothing": lambda text: "",
    "list": lambda text: "[]",
}


@pytest.mark.parametrize("name", BROKEN)
def test_the_reader_refuses(name: str) -> None:
    broken = BROKEN[name]((GOLDEN / NAME).read_text())
    assert broken != (GOLDEN / NAME).read_text()
    with pytest.raises(DecodeError, match="command stack cannot be decoded"):
        read_stack(broken.encode())


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("/SAT/STAR", "/SAT/STIR", "name is '/SAT/STIRTRACKER"),
        ('"value": 3', '"value": 4', "version is 4"),
        ('"value": 7', '"value": 6', "serial is 6, that is 6.0; the calibration has 7"),
        ('"value": 7', '"value": 7.5', "7.5 is no uint32"),
        ('"value": -0.0025', '"value": -0.0024', "tilt_2 is -0.0024"),
        ('"tilt_2"', '"tilt_3"', "arguments are version"),
        ("-0.0001234499941347167", "-0.00012345", "is no float32"),
        ("/cf/st16", "/cf/st17", "arguments is [('FILENAME', '/cf/st17_cal.tbl')]"),
        ("serial 7", "serial 8", "comment is 'ST16-1 serial 8"),
        ("1000", "1001", "wait_ms is 1001"),
        ("CommandComplete", "CommandCompleted", "acknowledgment is 'CommandCompleted'"),
        ("load only", "load and go", "other arguments or comment"),
    ],
)
def test_the_comparison_finds_a_wrong_stack(old: str, new: str, message: str) -> None:
    text = (GOLDEN / NAME).read_text()
    assert old in text
    files = encode_all(calibration(), example())
    files[NAME] = text.replace(old, new).encode()
    reasons = check_all(files, calibration(), example(), 60.0).reasons
    assert any(line.startswith("yamcs: ") and message in line for line in reasons)


def aggregate() -> tuple[Any, dict[str, bytes]]:
    document = example_document()
    document["yamcs"]["commands"][0]["argument"] = "val"
    target = as_target(document)
    return target, encode_all(calibration(), target)


def test_one_argument_with_the_fields_as_members() -> None:
    target, files = aggregate()
    ((name, value),) = read_stack(files[NAME])[0].arguments
    assert name == "val"
    assert list(value)[:3] == ["version", "serial", "focal_length"]
    assert value["alignment"] == calibration().c_sd.ravel().tolist()
    assert value["columns"] == 2592
    assert check_all(files, calibration(), target, 60.0).reasons == []


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"val"', '"vel"', "val is not its one argument"),
        ('"tilt_2"', '"tilt_3"', "arguments are version"),
        ('"tilt_2": -0.0025', '"tilt_2": [-0.0025, 1]', "is not a number"),
        ('"tilt_2": -0.0025', '"tilt_2": -0.0026', "tilt_2 is -0.0026"),
        ('"alignment"', '"alinement"', "arguments are version"),
    ],
)
def test_a_wrong_member_is_found(old: str, new: str, message: str) -> None:
    target, files = aggregate()
    text = files[NAME].decode()
    assert old in text
    files[NAME] = text.replace(old, new).encode()
    reasons = check_all(files, calibration(), target, 60.0).reasons
    assert any(line.startswith("yamcs: ") and message in line for line in reasons)
