"""A calibration in another camera model: alignment, covariance, verdict, provenance."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import ROOT

from stcal.calibration import Calibration, load, save
from stcal.cameras import CAMERAS, Camera
from stcal.constants import URAD
from stcal.errors import InputError
from stcal.geometry.rotations import matrix_from_vector
from stcal.pipeline.conversion import convert_calibration

WU = Camera(
    CAMERAS["pinhole-radial"], 1080, 1920, 2.9e-6,
    np.array([1.00002, 0.01601, 962.0, 545.0, -0.43, 0.2]),
)  # fmt: skip
SD = np.array([2e-5, 7e-7, 1.8, 1.5, 4e-3, 0.1])
C_SD = matrix_from_vector(np.array([[0.3, -0.2, 1.1]]))[0]
HASH = "5" * 64


def calibration(camera: Camera = WU, **changes) -> Calibration:
    root = np.random.default_rng(1).normal(size=(6, 6)) * SD[:, None]
    return replace(
        Calibration(
            "WU-1", 4, camera, C_SD, root @ root.T, {"telemetry_sha256": "a" * 64},
            {"verdict": {"accepted": True, "reasons": []}}, "old.json",
        ),
        **changes,
    )  # fmt: skip


@pytest.mark.parametrize("model", ["wang", "pixel-radial"])
def test_directions_in_the_sensors_frame_agree(model):
    old = calibration()
    found = convert_calibration(old, CAMERAS[model], HASH)
    rng = np.random.default_rng(2)
    m, n = rng.uniform(0, 1079, 500), rng.uniform(0, 1919, 500)
    new = found.calibration
    departure = new.camera.directions(m, n) @ new.c_sd.T - old.camera.directions(m, n) @ C_SD.T
    worst = found.document["errors"]["worst_urad"]
    assert 0.0 < worst < 3.0
    assert np.linalg.norm(departure, axis=1).max() <= worst * URAD


def test_a_turned_boresight_goes_into_c_sd():
    """The tilt turns D by 5 mrad; directions in S stay."""
    tilted = load(ROOT / "sample_telemetry" / "ST16-4.initial.json")
    x = tilted.camera.parameters.copy()
    x[5:7] += [0.004, -0.003]
    old = replace(tilted, camera=tilted.camera.with_parameters(x), c_sd=C_SD)
    new = convert_calibration(old, CAMERAS["pixel-radial"], HASH).calibration
    m, n = np.array([900.0, 1000.0]), np.array([1200.0, 1400.0])
    in_s = new.camera.directions(m, n) @ new.c_sd.T, old.camera.directions(m, n) @ C_SD.T
    assert np.abs(in_s[0] - in_s[1]).max() < 10 * URAD
    in_d = new.camera.directions(m, n), old.camera.directions(m, n)
    assert np.abs(in_d[0] - in_d[1]).max() > 2000 * URAD
    np.testing.assert_allclose(new.c_sd @ new.c_sd.T, np.eye(3), atol=1e-14)


def test_a_camera_that_the_model_cannot_follow_is_noted():
    tilted = load(ROOT / "sample_telemetry" / "truth" / "ST16-2.json")
    found = convert_calibration(tilted, CAMERAS["pinhole-radial"], HASH)
    worst = found.document["errors"]["worst_px"]
    assert worst > 1.0
    assert found.document["verdict"]["notes"] == [
        f"pinhole-radial cannot follow this camera: centroids move by up to {worst:.1f} px"
    ]


def test_its_own_model_is_exact():
    old = calibration()
    found = convert_calibration(old, WU.model, HASH, maximum_urad=0.0)
    new = found.calibration
    assert np.array_equal(new.camera.parameters, WU.parameters)
    assert np.array_equal(new.c_sd, C_SD)
    assert np.array_equal(new.covariance, old.covariance)
    assert found.document["errors"]["worst_urad"] == 0.0
    assert found.document["verdict"]["notes"] == []


def test_there_and_back_is_where_it_was():
    """Exactly where one model holds the other, else within what is left each way."""
    x = np.array([500.0, 530.0, 0.07404, 1.8e-8, -9e-15])
    zhang = calibration(
        Camera(CAMERAS["pixel-radial"], 1024, 1024, 18e-6, x),
        covariance=np.diag([0.66, 0.67, 2e-6, 2.2e-10, 4.2e-16]) ** 2,
    )
    through = convert_calibration(zhang, CAMERAS["wang"], HASH).calibration
    back = convert_calibration(through, CAMERAS["pixel-radial"], HASH).calibration
    np.testing.assert_allclose(back.camera.parameters, x, rtol=1e-9)
    np.testing.assert_allclose(back.c_sd, C_SD, atol=1e-13)
    sd = np.sqrt(np.diag(zhang.covariance))
    np.testing.assert_allclose(back.covariance / np.outer(sd, sd), np.eye(5), atol=1e-4)
    assert back.serial == zhang.serial + 2
    through = convert_calibration(calibration(), CAMERAS["wang"], HASH).calibration
    back = convert_calibration(through, WU.model, HASH).calibration
    assert (np.abs(back.camera.parameters - WU.parameters) < 0.5 * SD).all()


def test_the_covariance_follows_the_parameters():
    """Zhang's model is wang's with b2 = k1 / p^2 and b4 = k2 / p^4, all else alike."""
    x = np.array([500.0, 530.0, 0.07404, 1.8e-8, -9e-15])
    sd = np.array([0.66, 0.67, 2e-6, 2.2e-10, 4.2e-16])
    root = np.random.default_rng(4).normal(size=(5, 5)) * sd[:, None]
    zhang = Camera(CAMERAS["pixel-radial"], 1024, 1024, 18e-6, x)
    old = calibration(zhang, covariance=root @ root.T)
    new = convert_calibration(old, CAMERAS["wang"], HASH).calibration
    names = new.camera.parameter_names
    order = [names.index(n) for n in ("m0_px", "n0_px", "f_m", "b2_per_m2", "b4_per_m4")]
    unit = np.array([1.0, 1.0, 1.0, 18e-6**2, 18e-6**4])
    found = new.covariance[np.ix_(order, order)] * np.outer(unit, unit)
    np.testing.assert_allclose(
        found / np.outer(sd, sd), old.covariance / np.outer(sd, sd), atol=1e-6
    )
    sd_tilt = np.sqrt(new.covariance[names.index("a1_rad"), names.index("a1_rad")])
    assert sd_tilt < 1e-9


def test_what_the_new_file_says_of_itself(tmp_path):
    found = convert_calibration(calibration(), CAMERAS["wang"], HASH)
    save(found.calibration, tmp_path / "new.json")
    new = load(tmp_path / "new.json")
    assert (new.sensor_id, new.serial) == ("WU-1", 5)
    assert new.provenance["converted_from_sha256"] == HASH
    assert new.provenance["converted_from_model"] == "pinhole-radial"
    assert new.provenance["telemetry_sha256"] == "a" * 64
    assert new.quality["verdict"]["accepted"]
    assert new.quality["conversion"]["worst_urad"] == found.document["errors"]["worst_urad"]
    assert "without the error of the conversion" in found.document["verdict"]["notes"][0]
    plain = convert_calibration(calibration(covariance=None), CAMERAS["wang"], HASH)
    assert plain.calibration.covariance is None
    assert plain.document["verdict"]["notes"] == []


def test_the_document_maps_the_error():
    found = convert_calibration(calibration(), CAMERAS["pixel-radial"], HASH).document
    field, errors = found["field"], found["errors"]
    worst = int(np.argmax(field["error_urad"]))
    assert field["error_urad"][worst] == pytest.approx(errors["worst_urad"], abs=1e-4)
    assert (field["row_px"][worst], field["col_px"][worst]) == (
        errors["at_row_px"], errors["at_col_px"],
    )  # fmt: skip
    px = np.hypot(field["error_row_px"], field["error_col_px"])
    assert px.max() == pytest.approx(errors["worst_px"], abs=1e-6)
    assert np.sqrt(np.mean(px**2)) == pytest.approx(errors["rms_px"], abs=1e-6)
    # A pixel is 2.9 um behind 16 mm.
    assert errors["worst_urad"] / errors["worst_px"] == pytest.approx(181.0, rel=0.1)


def test_a_larger_error_than_allowed_is_refused():
    allowed = convert_calibration(calibration(), CAMERAS["wang"], HASH).document
    worst = allowed["errors"]["worst_urad"]
    found = convert_calibration(calibration(), CAMERAS["wang"], HASH, 0.9 * worst)
    assert found.calibration is None
    (reason,) = found.document["verdict"]["reasons"]
    assert "wang departs by" in reason
    assert "at row" in reason
    assert convert_calibration(calibration(), CAMERAS["wang"], HASH, 1.1 * worst).calibration


def test_a_camera_that_folds_its_field_is_bad_input():
    folded = WU.with_parameters(WU.parameters * [1, 1, 1, 1, 40, 1])
    with pytest.raises(InputError, match=r"old\.json: .* not one-to-one"):
        convert_calibration(calibration(folded), CAMERAS["wang"], HASH)
