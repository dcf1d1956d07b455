"""Encoders against the independent decoders, on any calibration."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stcal.calibration import Calibration
from stcal.cameras import CAMERAS, Camera
from stcal.uplink import decode, encode
from stcal.uplink.build import mismatches

FINITE = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e299, max_value=1e299)
NAMES = st.text(min_size=1).filter(str.isprintable)


@st.composite
def calibrations(draw: st.DrawFn) -> Calibration:
    model = CAMERAS["wang"]
    size = len(model.parameter_names)
    values = draw(st.lists(FINITE, min_size=size, max_size=size))
    half = draw(st.lists(st.floats(-1e100, 1e100), min_size=size * size, max_size=size * size))
    matrix = np.array(half).reshape(size, size)
    angles = draw(st.tuples(*[st.floats(-3, 3)] * 3))
    return Calibration(
        sensor_id=draw(NAMES),
        serial=draw(st.integers(0, 10**9)),
        camera=Camera(model, 1944, 2592, draw(st.floats(1e-9, 1e-3)), np.array(values)),
        c_sd=Rotation.from_euler("xyz", angles).as_matrix(),
        covariance=np.abs(matrix + matrix.T),
    )


def bits(value: float) -> bytes:
    return struct.pack("<d", value)


@settings(max_examples=60, deadline=None)
@given(calibrations(), calibrations())
def test_both_files_read_back_to_the_same_bits(new: Calibration, old: Calibration) -> None:
    table = decode.decode_table(encode.encode_table(new, old))
    file = decode.decode_calibration(encode.encode_calibration(new))
    for name in new.camera.parameter_names:
        assert bits(table.values[name]) == bits(file.values[name]) == bits(new.camera.value(name))
        assert bits(table.parents[name]) == bits(old.camera.value(name))
    assert table.texts["sensor_id"] == file.texts["sensor_id"] == new.sensor_id
    assert bits(table.values["c_sd_13"]) == bits(float(new.c_sd[0, 2]))
    files = {
        encode.CALIBRATION_FILE: encode.encode_calibration(new),
        encode.TABLE_FILE: encode.encode_table(new, old),
    }
    assert mismatches(files, new, old) == []


@settings(max_examples=30, deadline=None)
@given(calibrations(), st.integers(0, 7))
def test_one_bit_is_seen(new: Calibration, place: int) -> None:
    parameters = new.camera.parameters.copy()
    parameters[place] = np.nextafter(parameters[place], np.inf)
    other = replace(new, camera=new.camera.with_parameters(parameters))
    files = {
        encode.CALIBRATION_FILE: encode.encode_calibration(other),
        encode.TABLE_FILE: encode.encode_table(new, new),
    }
    name = new.camera.parameter_names[place]
    lines = mismatches(files, new, new)
    assert len(lines) == 1
    assert lines[0].startswith(f"calibration file {name}: decoded")


def test_sign_of_zero_is_a_difference() -> None:
    assert decode.differences("x", {"a": -0.0}, {"a": 0.0})
    assert not decode.differences("x", {"a": -0.0}, {"a": -0.0})


@pytest.mark.parametrize("content", [b"", b"\xff", b"name,value\n", b'"', b"a,b\nc,d\n"])
def test_not_a_table(content: bytes) -> None:
    with pytest.raises(decode.DecodeError):
        decode.decode_table(content)
