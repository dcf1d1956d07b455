from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from target_cases import as_target, calibration, example_document

from stcal.uplink.quantisation import RoundingEffect, rounding_effect, rounding_refusals
from stcal.uplink.tables import encode_checked


def rounded(name: str, **word: Any) -> Any:
    """Return the check of the example with one field in another word."""
    document = example_document()
    document["table"].pop("size_bytes")
    item = next(f for f in document["field"] if f["name"] == name)
    for key in ("fraction_bits", "unit", "minimum", "maximum"):
        item.pop(key, None)
    item |= word
    return encode_checked(calibration(), as_target(document), 60.0)[1]


def test_a_turn_of_c_sd_is_its_angle_everywhere() -> None:
    given = calibration()
    turn = Rotation.from_rotvec([0.0, 0.0, 5e-6]).as_matrix()
    tilt = Rotation.from_rotvec([3e-6, -4e-6, 0.0]).as_matrix()
    effect = rounding_effect(given, replace(given, c_sd=tilt @ given.c_sd))
    assert effect.worst_urad == pytest.approx(5.0, rel=1e-3)
    assert 4.9 < effect.rms_urad < 5.0
    # About the boresight the corners turn most.
    effect = rounding_effect(given, replace(given, c_sd=turn @ given.c_sd))
    assert effect.worst_urad == pytest.approx(5.0 * np.sin(0.216), rel=0.02)
    assert (effect.at_row_px, effect.at_col_px) == (-0.5, -0.5)


def test_a_principal_point_in_whole_pixels_is_refused() -> None:
    checked = rounded("row_0", scale=1.0)
    # 0.123 px of 2.2 um at 16 mm
    assert checked.figures["rounding"]["worst_urad"] == pytest.approx(16.9, rel=0.08)
    assert len(checked.reasons) == 1
    assert "rounding turns star vectors by up to 16" in checked.reasons[0]
    assert "beyond 0.6 urad, 0.01 of the fit's RMS 60" in checked.reasons[0]


def test_effect_counts_and_not_digits() -> None:
    # Both to some 5e-5 of their value.
    assert rounded("radial_4", word="int16", scale=1e4).reasons == []
    assert rounded("focal_length", word="int16", scale=1e-6).reasons != []
    assert rounded("focal_length", word="float32").reasons == []


def test_a_matrix_of_few_bits_is_refused_by_its_effect() -> None:
    fine = rounded("alignment", word="int32", fraction_bits=30)
    coarse = rounded("alignment", word="int16", fraction_bits=14)
    assert fine.reasons == []
    assert fine.figures["rounding"]["worst_urad"] < 0.01
    # 2^-15 at most in each of nine elements
    assert 1.0 < coarse.figures["rounding"]["worst_urad"] < 3 * 2**-15 * 1e6
    assert len(coarse.reasons) == 1


def test_the_worst_place_counts() -> None:
    effect = RoundingEffect(rms_urad=3.0, worst_urad=16.0, at_row_px=-0.5, at_col_px=2591.5)
    assert rounding_refusals(effect, 1600.0, 0.01) == []
    (reason,) = rounding_refusals(effect, 1599.0, 0.01)
    assert "up to 16 urad (at row -0.5, column 2591.5; RMS 3)" in reason


@pytest.mark.parametrize("rms", [None, 0.0, np.nan, np.inf])
def test_without_an_rms_nothing_can_be_judged(rms: float | None) -> None:
    effect = rounding_effect(calibration(), calibration())
    assert effect.worst_urad < 1e-9
    assert rounding_refusals(effect, 1.0, 0.01) == []
    (reason,) = rounding_refusals(effect, rms, 0.01)
    assert "there is nothing to judge it by" in reason


def test_a_camera_without_directions_is_infinitely_wrong() -> None:
    given = calibration()
    names = given.camera.parameter_names
    broken = np.where(np.array(names) == "f_m", 0.0, given.camera.parameters)
    held = replace(given, camera=given.camera.with_parameters(broken))
    held = replace(held, c_sd=np.full((3, 3), np.nan))
    effect = rounding_effect(given, held)
    assert effect.worst_urad == np.inf
    assert rounding_refusals(effect, 60.0, 1.0)
