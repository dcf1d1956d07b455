from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from target_cases import (
    EXAMPLE,
    PARAMETERS,
    ROOT,
    as_target,
    calibration,
    example,
    example_document,
)
from target_strategies import UNITS, calibrations, documents

from stcal.calibration import Calibration
from stcal.cameras import CAMERAS, Camera
from stcal.config import load_config
from stcal.uplink.formats.read_words import by_meaning, places, reading
from stcal.uplink.formats.words import EncodeError
from stcal.uplink.quantisation import held_calibration
from stcal.uplink.read_back import read_back
from stcal.uplink.tables import check_all, encode_all, encode_checked
from stcal.uplink.target import Target, load_target

# With numbers that are zero.
PLAIN = calibration(c_sd=np.eye(3), a2_rad=0.0)


def field(document: dict[str, Any], name: str) -> dict[str, Any]:
    return next(item for item in document["field"] if item["name"] == name)


def test_the_example_passes() -> None:
    files, checked = encode_checked(calibration(), example(), 60.0)
    assert sorted(files) == ["ST16_CAL.bin", "ST16_CAL_def.txt", "st16_cal.dat", "st16_cal.tbl",
                             "st16_cal.ycs"]  # fmt: skip
    assert checked.reasons == []
    assert files == encode_all(calibration(), example())


def test_figures() -> None:
    figures = encode_checked(calibration(), example(), 60.0)[1].figures
    assert figures["payload_bytes"] == {
        "st16_cal.tbl": 144, "st16_cal.dat": 130, "ST16_CAL.bin": 144,
    }  # fmt: skip
    crc = figures["crc16_arc"]
    assert crc["st16_cal.tbl"] == crc["ST16_CAL.bin"] != crc["st16_cal.dat"]
    rounding = figures["rounding"]
    assert rounding["limit_urad"] == pytest.approx(0.6)
    assert rounding["fit_rms_urad"] == 60.0
    assert 0.0 < rounding["rms_urad"] < rounding["worst_urad"] < 0.6
    row = next(item for item in figures["fields"] if item["name"] == "row_0")
    assert row["holds"] == "m0_px"
    assert row["value"] == 980.123
    assert row["on_target"] == round(980.123 * 65536)
    assert 0.0 < abs(row["error"]) <= 0.5 / 65536
    assert (row["unit"], row["word"], row["minimum"], row["maximum"]) == ("px", "int32", 472, 1472)
    version = next(item for item in figures["fields"] if item["name"] == "version")
    assert (version["value"], version["error"]) == (3, 0.0)


@settings(max_examples=60, deadline=None)
@given(calibrations(), documents())
def test_every_target_reads_back_what_was_given(fitted: Calibration, document: Any) -> None:
    target = as_target(document)
    files, checked = encode_checked(fitted, target, 1e3)
    assert checked.reasons == []
    for found in read_back(files, fitted, target).values():
        held = held_calibration(by_meaning(found.numbers), fitted)
        assert held.serial == fitted.serial
        np.testing.assert_allclose(held.c_sd, fitted.c_sd, atol=3e-7)
        steps = [2e-9, 2e-4, 2e-4, 60.0, 6e-4, 4e-9, 4e-9, 2e-7]
        apart = np.abs(held.camera.parameters - fitted.camera.parameters)
        assert (apart <= steps).all()


@settings(max_examples=60, deadline=None)
@given(calibrations(), st.sampled_from(["c_sd", "q_sd", "q_ds"]))
def test_doubles_in_si_keep_every_bit(fitted: Calibration, alignment: str) -> None:
    document = example_document()
    document["table"].pop("size_bytes")
    for item in document["field"]:
        if item["value"] in UNITS:
            item["word"] = "float64"
            for key in ("unit", "fraction_bits", "minimum", "maximum"):
                item.pop(key, None)
    field(document, "alignment").pop("order")
    field(document, "alignment")["value"] = alignment
    target = as_target(document)
    files, checked = encode_checked(fitted, target, 1.0)
    assert checked.reasons == []
    held = held_calibration(by_meaning(read_back(files, fitted, target)["cfe"].numbers), fitted)
    assert (held.camera.parameters == fitted.camera.parameters).all()
    np.testing.assert_allclose(held.c_sd, fitted.c_sd, atol=0 if alignment == "c_sd" else 2e-15)


@pytest.mark.parametrize("alignment", ["q_sd", "q_ds"])
def test_convention_of_the_quaternion(alignment: str) -> None:
    document = example_document()
    field(document, "alignment").update(value=alignment, order="wxyz")
    document["table"].pop("size_bytes")
    # From D to S by a quarter turn about z: x_d becomes y_s.
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    target, turned = as_target(document), calibration(c_sd=quarter)
    figures = encode_checked(turned, target, 60.0)[1].figures["fields"]
    found = {item["name"]: item["on_target"] for item in figures}
    # A(q) of q = (0, 0, sin, cos) turns components as a turn of the axes: the other way round.
    half = np.sqrt(0.5)
    expected = [half, 0.0, 0.0, -half if alignment == "q_sd" else half]
    assert [found[f"alignment_{k}"] for k in "wxyz"] == pytest.approx(expected, abs=1e-15)


# --- refusals ------------------------------------------------------------------------------------

REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "nan": ({"f_m": np.nan}, "focal_length (f_m) is nan"),
    "infinity": ({"b2_per_m2": -np.inf}, "radial_2 (b2_per_m2) is -inf"),
    "matrix": ({"c_sd": np.diag([1.0, np.nan, 1.0])}, "alignment_22 (c_sd_22) is nan"),
    "low": ({"f_m": 0.0154}, "focal_length (f_m) is 15.4 mm, below the target's minimum 15.5"),
    "high": ({"a1_rad": 0.11}, "tilt_1 (a1_rad) is 0.11 rad, above the target's maximum 0.1"),
    "count": ({"n0_px": 40000.0}, "column_0 (n0_px) = 40000.0 does not fit int32: 40000 px"),
    "single": ({"b4_per_m4": 1e300}, "radial_4 (b4_per_m4) = 1e+300 does not fit float32"),
    "serial": ({"serial": 2**32}, "serial = 4294967296 does not fit uint32"),
    "sensor": ({"sensor_id": "SPEL-1"}, "sensor_id 'SPEL-1': the target is for ST16-*"),
    "name": ({"sensor_id": "ST16-<%"}, "cannot be written"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_the_target_cannot_hold_is_refused(name: str) -> None:
    changes, message = REFUSED[name]
    files, checked = encode_checked(calibration(**changes), example(), 60.0)
    assert files == {}
    assert any(message in reason for reason in checked.reasons)
    with pytest.raises(EncodeError):
        encode_all(calibration(**changes), example())


def test_every_reason_is_told() -> None:
    broken = calibration(f_m=np.nan, a1_rad=0.2, a2_rad=-0.2, n0_px=4e5)
    reasons = encode_checked(broken, example(), 60.0)[1].reasons
    assert len(reasons) == 5  # n0 is beyond its word and its limit


def test_another_detector_or_camera_model_is_refused() -> None:
    given = calibration()
    wide = replace(given, camera=replace(given.camera, cols=2600))
    assert encode_checked(wide, example(), 60.0)[1].reasons == [
        "camera.cols is 2600, the target's is 2592"
    ]
    model = CAMERAS["pixel-radial"]
    values = model.undistorted(0.016, 972.0, 1296.0)
    other = replace(given, camera=replace(given.camera, model=model, parameters=values))
    assert encode_checked(other, example(), 60.0)[1].reasons == [
        "camera model is 'pixel-radial', the target computes with 'wang'"
    ]


def test_missing_and_foreign_files_are_told() -> None:
    files = encode_all(calibration(), example())
    files["other.tbl"] = files.pop("st16_cal.tbl")
    reasons = check_all(files, calibration(), example(), 60.0).reasons
    assert reasons == ["cfe: st16_cal.tbl: missing", "other.tbl: no file of this target"]


def test_files_of_another_calibration_are_told() -> None:
    files = encode_all(calibration(), example())
    given = calibration(a1_rad=np.nextafter(PARAMETERS[5], 1.0))
    reasons = check_all(files, given, example(), 60.0).reasons
    assert sum("tilt_1 is 0.001, that is 0.001; the calibration has" in r for r in reasons) == 4


def decoded_problems(files: dict[str, bytes], target: Target) -> list[str]:
    found = read_back(files, PLAIN, target)
    return [line for format_ in found.values() for line in format_.problems]


@pytest.mark.parametrize("format_", ["cfe", "fprime", "fprime without CRC"])
def test_the_decoder_finds_every_flipped_bit(format_: str) -> None:
    document = example_document()
    document["fprime"]["crc_prefix"] = format_ == "fprime"
    for other in {"cfe", "fprime", "openc3", "yamcs"} - {format_.split()[0]}:
        document.pop(other)
    target = as_target(document)
    files = encode_all(PLAIN, target)
    (name,) = files
    assert decoded_problems(files, target) == []
    content = files[name]
    unseen = []
    for bit in range(8 * len(content)):
        flipped = bytearray(content)
        flipped[bit // 8] ^= 1 << (bit % 8)
        if not decoded_problems({name: bytes(flipped)}, target):
            unseen.append(bit)
    assert unseen == []


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_a_flipped_bit_in_any_file_is_found(data: st.DataObject) -> None:
    files = encode_all(calibration(), example())
    name = data.draw(st.sampled_from(sorted(files)))
    bit = data.draw(st.integers(0, 8 * len(files[name]) - 1))
    flipped = bytearray(files[name])
    flipped[bit // 8] ^= 1 << (bit % 8)
    reasons = check_all(files | {name: bytes(flipped)}, calibration(), example(), 60.0).reasons
    assert any(name in reason for reason in reasons)


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_damage_of_any_kind_is_told_and_never_raises(data: st.DataObject) -> None:
    files = encode_all(calibration(), example())
    name = data.draw(st.sampled_from(sorted(files)))
    content = files[name]
    start = data.draw(st.integers(0, len(content) - 1))
    stop = data.draw(st.integers(start, min(len(content), start + 40)))
    new = data.draw(st.binary(max_size=40) | st.sampled_from([b"[]", b"{}", b"null", b"1e999"]))
    damaged = content[:start] + new + content[stop:]
    if damaged != content:
        reasons = check_all(files | {name: damaged}, calibration(), example(), 60.0).reasons
        assert any(name in reason for reason in reasons)


def test_cut_and_longer_files_are_found() -> None:
    files = encode_all(calibration(), example())
    for name, content in files.items():
        for changed in (content[:-1], content + b"\0", b""):
            reasons = check_all(files | {name: changed}, calibration(), example(), 60.0).reasons
            assert any(name in reason for reason in reasons)


@settings(max_examples=300, deadline=None)
@given(st.floats(0.9901, 1.0099))
def test_singles_are_the_nearest(value: float) -> None:
    document = example_document()
    document["table"].pop("size_bytes")
    field(document, "column_scale")["word"] = "float32"
    target = as_target(document)
    figures = encode_checked(calibration(g_y=value), target, 60.0)[1].figures["fields"]
    found = next(item["on_target"] for item in figures if item["name"] == "column_scale")
    assert found == float(np.float32(value))


@pytest.mark.parametrize(("value", "expected"), [(0.5, 0), (1.5, 2), (2.5, 2), (-0.5, 0)])
def test_ties_go_to_the_even_count(value: float, expected: int) -> None:
    document = example_document()
    row = field(document, "row_0")
    row.pop("fraction_bits")
    row |= {"scale": 1.0, "minimum": -10.0}
    target = as_target(document)
    checked = encode_checked(calibration(m0_px=value), target, 1e9)[1]
    found = next(item for item in checked.figures["fields"] if item["name"] == "row_0")
    assert found["on_target"] == expected
    assert checked.reasons == []


def test_the_odd_count_of_a_tie_is_told() -> None:
    document = example_document()
    row = field(document, "row_0")
    row.pop("fraction_bits")
    row |= {"scale": 1.0, "minimum": -10.0}
    target, tied = as_target(document), calibration(m0_px=0.5)
    files = encode_all(tied, target)
    offset = 116 + next(p.offset for p in places(target)[0] if p.label == "row_0")
    table = bytearray(files["st16_cal.tbl"])
    table[offset] = 1
    (problem,) = read_back(files | {"st16_cal.tbl": bytes(table)}, tied, target)["cfe"].problems
    assert problem == "cfe: row_0 is 1, that is 1.0; the calibration has 0.5"


@pytest.mark.parametrize("word", ["float32", "float64"])
@pytest.mark.parametrize("number", [1.0, -1.0, 0.0, -0.75, 3.4028234e38, -1e-40])
def test_neighbours_are_those_of_numpy(word: str, number: float) -> None:
    document = example_document()
    document["table"].pop("size_bytes")
    field(document, "column_scale")["word"] = word
    place = next(p for p in places(as_target(document))[0] if p.label == "column_scale")
    kind: Any = np.float32 if word == "float32" else np.float64
    value = kind(number)
    found = reading(place, np.array(value, dtype=value.dtype.newbyteorder(">")).tobytes())
    with np.errstate(over="ignore"):
        around = [float(np.nextafter(value, kind(side))) for side in (-np.inf, np.inf)]
    expected = [Fraction(x) if np.isfinite(x) else None for x in around]
    assert [found.below, found.above] == expected
    assert found.value == Fraction(float(value))


def test_a_negative_zero_becomes_zero() -> None:
    files, checked = encode_checked(calibration(a1_rad=-0.0), example(), 60.0)
    assert checked.reasons == []
    numbers = read_back(files, calibration(a1_rad=0.0), example())["cfe"].numbers
    assert by_meaning(numbers)["a1_rad"] == Fraction(0)


@pytest.mark.parametrize("path", sorted(EXAMPLE.parent.glob("*.toml")), ids=lambda p: p.stem)
def test_every_example_takes_the_calibrations_of_its_sensors(path: Path) -> None:
    target = load_target(path)
    configs = [load_config(p) for p in sorted((ROOT / "configs").glob("*.toml"))]
    sensor = target.sensor_ids[0].replace("*", "1")
    (config,) = [c for c in configs if c.applies_to(sensor)]
    scale = [config.camera.scale[name] for name in CAMERAS[target.model].parameter_names]
    for sigmas in (0.0, 4.0, -4.0):
        values = np.array([s.nominal + sigmas * s.sigma for s in scale])
        detector = config.detector
        camera = Camera(
            CAMERAS[config.camera.model], detector.rows, detector.cols, detector.pixel_size_m,
            values,
        )  # fmt: skip
        given = calibration(sensor_id=sensor, camera=camera)
        files, checked = encode_checked(given, target, 60.0)
        assert checked.reasons == []
        assert files
