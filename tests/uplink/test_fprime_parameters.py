from __future__ import annotations

import itertools
import json
import struct
import sys
import tempfile
import zlib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from target_cases import FOCAL_MM, GOLDEN, as_target, calibration, example, example_document
from target_strategies import calibrations, documents

from stcal.calibration import Calibration
from stcal.uplink.decode import DecodeError
from stcal.uplink.formats.fprime import encode, prefix, record
from stcal.uplink.formats.read_fprime import read_parameter
from stcal.uplink.formats.read_words import read_numbers
from stcal.uplink.tables import encode_all


def encoded(calibration, target):
    return encode(target.fprime, calibration, target)


NAME = "st16_cal.dat"
COUNTER = itertools.count()
WORDS = {"float": "F", "int": "I", "uint": "U"}


def dictionary(document: dict[str, Any]) -> dict[str, Any]:
    """Return an F Prime dictionary whose only parameter is the target's structure."""
    members: dict[str, Any] = {}
    for item in document["field"]:
        if item["value"] == "padding":
            continue
        bits = int("".join(c for c in item["word"] if c.isdigit()))
        kind = item["word"].rstrip("0123456789")
        word: dict[str, Any] = {"name": f"{WORDS[kind]}{bits}", "size": bits}
        word |= {"kind": "float"} if kind == "float" else {"kind": "integer"}
        if kind != "float":
            word["signed"] = kind == "int"
        members[item["name"]] = {"type": word, "index": len(members)}
        sizes = {"c_sd": 9, "q_sd": 4, "q_ds": 4}
        if item["value"] in sizes:
            members[item["name"]]["size"] = sizes[item["value"]]
    return {
        "metadata": {
            "deploymentName": "Test",
            "projectVersion": "1",
            "frameworkVersion": "4.0.0",
            "libraryVersions": [],
            "dictionarySpecVersion": "1.0.0",
        },
        "typeDefinitions": [
            {"kind": "struct", "qualifiedName": "St.Calibration", "members": members}
        ],
        "constants": [],
        "commands": [],
        "events": [],
        "telemetryChannels": [],
        "records": [],
        "containers": [],
        "telemetryPacketSets": [],
        "parameters": [
            {
                "name": "Test.st.CALIBRATION",
                "type": {"name": "St.Calibration", "kind": "qualifiedIdentifier"},
                "id": document["fprime"]["parameter_id"],
            }
        ],
    }


def run_tool(tool: str, arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Run one of fprime-gds's own commands in this process."""
    from fprime_gds.common.tools import params

    monkeypatch.setattr(sys, "argv", [tool, *arguments])
    {"fprime-prm-decode": params.main_decode, "fprime-prm-write": params.main_encode}[tool]()


def test_the_example_of_the_format() -> None:
    content = record(0x1235, struct.pack(">d", 2137.512))
    assert content.hex() == "a50000000c0000123540a0b30624dd2f1b"
    assert f"{prefix(content):08x}" == "c4869c1c"
    whole = bytes.fromhex("c4869c1c") + content
    found = read_parameter(whole, crc_prefix=True)
    assert found.identifier == 0x1235
    assert struct.unpack(">d", found.value) == (2137.512,)


@pytest.mark.parametrize("order", ["row", "column"])
def test_fprime_gds_reads_the_numbers(
    order: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    document = example_document()
    next(f for f in document["field"] if f["name"] == "alignment")["order"] = order
    (tmp_path / "dictionary.json").write_text(json.dumps(dictionary(document)))
    fitted = calibration()
    (tmp_path / NAME).write_bytes(encoded(fitted, as_target(document))[NAME])
    files = [str(tmp_path / name) for name in (NAME, "dictionary.json", "out.json")]
    run_tool("fprime-prm-decode", [files[0], "-d", files[1], "-o", files[2]], monkeypatch)
    found = json.loads((tmp_path / "out.json").read_text())["Test.st"]["CALIBRATION"]
    assert found["version"] == 3
    assert found["serial"] == 7
    assert found["focal_length"] == FOCAL_MM
    assert found["row_0"] == round(980.123 * 65536)
    assert found["radial_4"] == pytest.approx(-1.2345e-4, rel=1e-7)
    assert found["tilt_2"] == -2.5e-3
    matrix = fitted.c_sd if order == "row" else fitted.c_sd.T
    assert found["alignment"] == matrix.ravel().tolist()
    assert (found["rows"], found["columns"]) == (1944, 2592)
    assert "spare" not in found


def test_fprime_gds_writes_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    document = example_document()
    (tmp_path / "dictionary.json").write_text(json.dumps(dictionary(document)))
    content = encoded(calibration(), example())[NAME]
    (tmp_path / NAME).write_bytes(content)
    files = [str(tmp_path / name) for name in (NAME, "dictionary.json", "p.json", "again.dat")]
    run_tool("fprime-prm-decode", [files[0], "-d", files[1], "-o", files[2]], monkeypatch)
    run_tool("fprime-prm-write", ["dat", files[2], "-d", files[1], "-o", files[3]], monkeypatch)
    assert (tmp_path / "again.dat").read_bytes() == content


@settings(max_examples=25, deadline=None)
@given(calibrations(), documents())
def test_fprime_gds_agrees_on_any_target(fitted: Calibration, document: Any) -> None:
    from fprime_gds.common.loaders.prm_json_loader import PrmJsonLoader
    from fprime_gds.common.tools import params

    content = encoded(fitted, as_target(document))[NAME]
    # The loader keeps structures by name as long as the process lives.
    name = f"St.Calibration{next(COUNTER)}"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "dictionary.json"
        path.write_text(json.dumps(dictionary(document)).replace("St.Calibration", name))
        by_id, by_name, _ = PrmJsonLoader(str(path)).construct_dicts(None)
    decoded = params.params_to_json(params.decode_dat_to_params(content, by_id))
    assert decoded["Test.st"]["CALIBRATION"]["serial"] == fitted.serial
    assert params.parsed_json_to_dat(params.parse_json(decoded, by_name)) == content


def test_golden_file() -> None:
    assert encode_all(calibration(), example())[NAME] == (GOLDEN / NAME).read_bytes()


def test_without_the_crc() -> None:
    document = example_document()
    document["fprime"]["crc_prefix"] = False
    content = encoded(calibration(), as_target(document))[NAME]
    assert content == encoded(calibration(), example())[NAME][4:]
    assert read_parameter(content, crc_prefix=False).identifier == 0x1235
    with pytest.raises(DecodeError, match="CRC is 0xa5"):
        read_parameter(content, crc_prefix=True)


def test_the_reader_refuses() -> None:
    one = record(1, b"\1\2\3\4")

    def sealed(records: bytes) -> bytes:
        return struct.pack(">I", zlib.crc32(records) ^ 0xFFFFFFFF) + records

    cases = {
        b"": "0 bytes are no CRC",
        sealed(b""): "begins with nothing, not a5",
        sealed(b"\xa4" + one[1:]): "begins with a4, not a5",
        sealed(one + one): "one parameter was expected",
        sealed(one[:-1]): "the record says 8 bytes, 7 follow",
        sealed(one)[:-1] + b"\5": "CRC is",
    }
    for content, message in cases.items():
        with pytest.raises(DecodeError, match=message):
            read_parameter(content, crc_prefix=True)


def test_numbers_are_packed_and_big_endian() -> None:
    content = encoded(calibration(), example())[NAME]
    value = read_parameter(content, crc_prefix=True).value
    assert value[:14] == struct.pack(">HId", 3, 7, FOCAL_MM)
    numbers = read_numbers(value, example(), packed=True)
    assert [r.number for r in numbers[:3]] == [3, 7, FOCAL_MM]
