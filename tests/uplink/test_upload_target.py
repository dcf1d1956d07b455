from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from target_cases import as_target, example, example_document, toml

from stcal.errors import ConfigError
from stcal.uplink.target import load_target, target_sha256

Change = Callable[[dict[str, Any]], object]


def field(document: dict[str, Any], name: str) -> dict[str, Any]:
    return next(item for item in document["field"] if item["name"] == name)


def test_the_example_is_the_document_that_the_tests_change(tmp_path: Path) -> None:
    again = as_target(example_document(), tmp_path)
    assert again == example()
    assert target_sha256(again) == target_sha256(example())
    assert example().applies_to("ST16-4")
    assert not example().applies_to("SPEL-1")


WRONG: dict[str, tuple[Change, str]] = {
    "schema": (lambda d: d.update(schema="stcal.upload-target/2"), "schema: "),
    "model": (lambda d: d.update(model="fisheye"), "model: 'fisheye' is not known"),
    "no format": (
        lambda d: [d.pop(k) for k in ("cfe", "fprime", "openc3", "yamcs")],
        "no format: one of cfe, fprime, openc3, yamcs must be there",
    ),
    "missing parameter": (lambda d: field(d, "tilt_1").update(value="constant"), "holds a1_rad"),
    "missing serial": (lambda d: d["field"].remove(field(d, "serial")), "no field holds serial"),
    "missing alignment": (
        lambda d: d["field"].remove(field(d, "alignment")),
        "exactly one of c_sd, q_sd, q_ds must be there: none",
    ),
    "two alignments": (
        lambda d: d["field"].append({"name": "q", "value": "q_sd", "word": "float64"}),
        "exactly one of c_sd, q_sd, q_ds must be there: ['c_sd', 'q_sd']",
    ),
    "name twice": (lambda d: field(d, "tilt_1").update(name="Tilt_2"), "TILT_2 occurs 2 times"),
    "value twice": (lambda d: field(d, "tilt_1").update(value="g_y"), "'g_y' occurs 2 times"),
    "unknown value": (lambda d: field(d, "tilt_1").update(value="k1"), "'k1' is not known"),
    "unscaled": (
        lambda d: field(d, "row_0").pop("fraction_bits"),
        "m0_px in int32 needs scale or fraction_bits",
    ),
    "scaled twice": (lambda d: field(d, "row_0").update(scale=0.5), "exclude each other"),
    "scaled float": (lambda d: field(d, "tilt_1").update(scale=0.5), "a float64 has no scale"),
    "unit": (lambda d: field(d, "tilt_1").update(unit="mm"), "unit 'mm' cannot hold a1_rad"),
    "power": (
        lambda d: field(d, "radial_2").update(unit="mm^-4"),
        "unit 'mm^-4' cannot hold b2_per_m2, which is in m^-2",
    ),
    "order": (lambda d: field(d, "alignment").update(order="xyzw"), "'xyzw' is not one of c_sd"),
    "constant": (lambda d: field(d, "version").update(constant=65536), "does not fit uint16"),
    "no constant": (lambda d: field(d, "version").pop("constant"), "constant goes with value"),
    "no count": (lambda d: field(d, "spare").pop("count"), "count goes with value"),
    "no word": (lambda d: field(d, "tilt_1").pop("word"), "word is missing"),
    "float serial": (lambda d: field(d, "serial").update(word="float32"), "is a whole number"),
    "limits": (lambda d: field(d, "tilt_1").update(minimum=1.0), "is above maximum"),
    "sizeof": (
        lambda d: d["table"].update(size_bytes=160),
        "table.size_bytes is 160; the fields make a structure of 144 bytes",
    ),
    "table name": (lambda d: d["cfe"].update(table_name="A" * 40), "cfe.table_name: "),
    "description": (lambda d: d["cfe"].update(description="D" * 32), "cfe.description: "),
    "code": (lambda d: d["openc3"].update(description="<% exit %>"), "openc3.description: "),
    "epoch": (lambda d: d["cfe"].update(epoch_utc="1980-13-01T00:00:00Z"), "cfe.epoch_utc: "),
    "id": (lambda d: d["fprime"].update(parameter_id=2**32), "fprime.parameter_id: "),
    "path": (lambda d: d["cfe"].update(file="../st16.tbl"), "cfe.file: is not a plain file name"),
    "same file": (lambda d: d["fprime"].update(file="ST16_CAL.tbl"), "st16_cal.tbl is used 2"),
    "taken": (lambda d: d["cfe"].update(file="Manifest.json"), "manifest.json is taken"),
    "partial": (lambda d: d["openc3"].update(definition="_a.txt"), "openc3.definition: must"),
    "no command": (
        lambda d: d["yamcs"]["commands"][0].update(calibration=False),
        "exactly one command must have calibration",
    ),
    "argument": (
        lambda d: d["yamcs"]["commands"][1].update(argument="val"),
        "argument goes with calibration = true",
    ),
    "part of the RMS": (
        lambda d: d["rounding"].update(maximum_part_of_rms=0.0),
        "rounding.maximum_part_of_rms: ",
    ),
    "unknown key": (lambda d: d["table"].update(endian="big"), "table.endian: "),
    "word": (lambda d: field(d, "tilt_1").update(word="float16"), "word: Input should be"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_told(name: str, tmp_path: Path) -> None:
    change, message = WRONG[name]
    document = example_document()
    change(document)
    with pytest.raises(ConfigError) as caught:
        as_target(document, tmp_path)
    assert str(tmp_path / "target.toml") in str(caught.value)
    assert message in str(caught.value)


def test_all_that_is_wrong_is_told_at_once(tmp_path: Path) -> None:
    document = example_document()
    for name in ("unscaled", "power", "missing serial", "path", "word", "name twice"):
        WRONG[name][0](document)
    with pytest.raises(ConfigError) as caught:
        as_target(document, tmp_path)
    for message in ("needs scale", "cannot hold", "no field holds serial", "plain file name",
                    "Input should be", "TILT_2 occurs 2 times"):  # fmt: skip
        assert message in str(caught.value)


def test_a_wrong_field_is_named(tmp_path: Path) -> None:
    document = example_document()
    field(document, "tilt_2").update(unit="mm")
    with pytest.raises(ConfigError, match=r"field\.tilt_2: unit 'mm' cannot hold"):
        as_target(document, tmp_path)


def test_a_file_that_is_no_target(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text("field = 3\n")
    with pytest.raises(ConfigError, match="table: Field required"):
        load_target(tmp_path / "a.toml")
    with pytest.raises(ConfigError, match="cannot be read"):
        load_target(tmp_path / "none.toml")


def test_the_helper_writes_what_it_was_given() -> None:
    import tomllib

    assert tomllib.loads(toml(example_document())) == example_document()
