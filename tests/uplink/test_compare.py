from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sample_calibrations import (
    SD,
    WANG,
    fitted_document,
    parent_document,
    rotation_z,
    write,
    write_pair,
)
from scipy.spatial.transform import Rotation

from stcal.calibration import Calibration, load
from stcal.cli import main
from stcal.constants import ARCSEC
from stcal.errors import InputError
from stcal.uplink.compare import c_sd_rotation, compare, direction_change


def pair(folder: Path, **parameters: float) -> tuple[Calibration, Calibration]:
    new, old = write_pair(folder, **parameters)
    return load(old), load(new)


def test_changes_in_units_and_sd(tmp_path: Path) -> None:
    document = compare(*pair(tmp_path, f_m=0.01598, m0_px=982.0))
    found = {item["name"]: item for item in document["parameters"]}
    assert list(found) == list(WANG)
    assert found["m0_px"]["change"] == 10.0
    assert found["m0_px"]["sd"] == 2.0
    assert found["m0_px"]["change_sd"] == 5.0
    assert found["m0_px"]["unit"] == "px"
    assert found["m0_px"]["change_combined_sd"] is None
    assert found["f_m"]["change_sd"] == pytest.approx(-2e-5 / 2e-7)
    assert found["g_y"]["change_sd"] == 0.0


def test_sd_of_both(tmp_path: Path) -> None:
    old, new = tmp_path / "a.json", tmp_path / "b.json"
    first = fitted_document("0" * 64)
    first["covariance"]["matrix"][1][1] = 1.5**2
    write(old, first)
    write(new, fitted_document("0" * 64, m0_px=982.0))
    found = compare(load(old), load(new))["parameters"][1]
    # sd 1.5 and 2.0: combined 2.5
    assert found["change_combined_sd"] == pytest.approx(4.0)


def test_c_sd_rotation_is_new_from_old_about_the_axes_of_s(tmp_path: Path) -> None:
    old, new = pair(tmp_path)
    np.testing.assert_allclose(c_sd_rotation(old, new), [0, 0, 1e-3 / ARCSEC], atol=1e-6)
    np.testing.assert_allclose(c_sd_rotation(new, old), [0, 0, -1e-3 / ARCSEC], atol=1e-6)


def test_c_sd_rotation_is_in_s_and_not_in_d(tmp_path: Path) -> None:
    document = parent_document()
    quarter = Rotation.from_rotvec([0, np.pi / 2, 0]).as_matrix()
    document["c_sd"] = quarter.tolist()
    old, new = tmp_path / "a.json", tmp_path / "b.json"
    write(old, document)
    document["c_sd"] = (np.array(rotation_z(1e-3)) @ quarter).tolist()
    write(new, document)
    turned = c_sd_rotation(load(old), load(new))
    np.testing.assert_allclose(turned, [0, 0, 1e-3 / ARCSEC], atol=1e-4)


def test_focal_length_alone_changes_directions_by_hand_computed_angles(tmp_path: Path) -> None:
    old, new = pair(tmp_path, f_m=0.01598)
    change = direction_change(old, new)
    # No best rotation by symmetry (the grid is centred half a pixel off the principal point).
    assert np.abs(change.rotation_d_arcsec).max() < 0.2
    m = np.array([-0.5, 1943.5]) - 972.0
    n = np.array([-0.5, 2591.5]) - 1296.0
    radius = 2.2e-6 * np.hypot(m[0], n[0])
    expected = np.arctan2(radius, 0.01598) - np.arctan2(radius, 0.016)
    assert change.worst_urad == pytest.approx(expected * 1e6, rel=2e-3)
    assert change.at_row_px in (-0.5, 1943.5)
    assert change.at_col_px in (-0.5, 2591.5)
    assert 0 < change.rms_urad < change.worst_urad


def test_moved_principal_point_is_mostly_rotation_and_its_sign(tmp_path: Path) -> None:
    old, new = pair(tmp_path, m0_px=972.0 + 290.0)
    change = direction_change(old, new)
    # Directions move to smaller x: about +y by -atan(290 px / f) (z towards -x).
    angle = np.arctan(290 * 2.2e-6 / 0.016) / ARCSEC
    assert change.rotation_d_arcsec[1] == pytest.approx(-angle, rel=0.02)
    assert np.abs(change.rotation_d_arcsec[[0, 2]]).max() < 1e-3 * angle
    assert change.worst_urad < 0.1 * angle * ARCSEC * 1e6


def test_c_sd_that_takes_the_rotation_back_leaves_no_jump(tmp_path: Path) -> None:
    old, new = pair(tmp_path, m0_px=972.0 + 290.0)
    rotation = Rotation.from_rotvec(direction_change(old, new).rotation_d_arcsec * ARCSEC)
    document = json.loads((tmp_path / "new.json").read_text())
    document["c_sd"] = rotation.inv().as_matrix().tolist()
    write(tmp_path / "new.json", document)
    jump = direction_change(old, load(tmp_path / "new.json")).net_s_arcsec
    assert np.abs(jump).max() < 1e-5
    document["c_sd"] = rotation.as_matrix().tolist()
    write(tmp_path / "new.json", document)
    doubled = direction_change(old, load(tmp_path / "new.json")).net_s_arcsec
    assert np.linalg.norm(doubled) > 2 * 8000


def test_equal_calibrations_do_not_differ(tmp_path: Path) -> None:
    old, _ = pair(tmp_path)
    document = compare(old, old)
    assert document["directions"]["worst_urad"] < 1e-8
    assert document["c_sd_rotation_arcsec"] == [0.0, 0.0, 0.0]
    assert all(item["change"] == 0.0 for item in document["parameters"])


def test_other_detector_is_bad_input(tmp_path: Path) -> None:
    old, _ = pair(tmp_path)
    document = json.loads((tmp_path / "new.json").read_text())
    document["camera"]["rows"] = 1000
    write(tmp_path / "new.json", document)
    with pytest.raises(InputError, match=r"not comparable: .*old\.json is .*; .*new\.json is"):
        compare(old, load(tmp_path / "new.json"))


def test_the_calibration_without_directions_is_named(tmp_path: Path) -> None:
    old, _ = pair(tmp_path)
    names = old.camera.parameter_names
    values = np.where(np.array(names) == "f_m", np.nan, old.camera.parameters)
    broken = replace(old, camera=old.camera.with_parameters(values), origin="new.json")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError, match=r"new\.json: gives no directions"):
            compare(old, broken)


def test_command_equals_the_core(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    new, old = write_pair(tmp_path, m0_px=982.0)
    assert main(["uplink", "diff", str(old), str(new), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == compare(load(old), load(new))
    assert main(["uplink", "diff", str(old), str(new)]) == 0
    shown = capsys.readouterr().out
    assert "+10.0" in shown
    assert "+5.0" in shown
    assert "+206.26" in shown
    assert len(SD) == 8


def test_missing_file_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    new, _ = write_pair(tmp_path)
    assert main(["uplink", "diff", str(tmp_path / "none.json"), str(new)]) == 3
    assert "none.json" in capsys.readouterr().err
