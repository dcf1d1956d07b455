import json
from dataclasses import replace

import numpy as np
import pytest
from conftest import ROOT
from hypothesis import given
from hypothesis import strategies as st

from stcal.calibration import Calibration, load, save
from stcal.cameras import CAMERAS, Camera
from stcal.errors import InputError

MINIMAL = {
    "schema": "stcal.calibration/1", "sensor_id": "ST16-1", "serial": 1,
    "camera": {"model": "wang", "rows": 1944, "cols": 2592, "pixel_size_m": 2.2e-6,
               "parameters": {"f_m": 0.016, "m0_px": 972.0, "n0_px": 1296.0, "b4_per_m4": 0.0,
                              "b2_per_m2": 0.0, "a1_rad": 0.0, "a2_rad": 0.0, "g_y": 1.0}},
    "c_sd": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
}  # fmt: skip


def write(path, document):
    path.write_text(document if isinstance(document, str) else json.dumps(document))
    return path


def test_the_minimal_form_is_read(tmp_path):
    found = load(write(tmp_path / "c.json", MINIMAL))
    assert found.sensor_id == "ST16-1"
    assert found.camera.value("f_m") == 0.016
    assert found.covariance is None


finite = st.floats(-8.0, 8.0, allow_nan=False)


@given(st.lists(finite, min_size=8, max_size=8), st.integers(0, 10**9), st.randoms())
def test_every_float_round_trips(tmp_path_factory, values, serial, random):
    nominal = np.array([0.016, 972.0, 1296.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    sigma = np.array([8e-6, 30.0, 30.0, 1e8, 1e3, 0.01, 0.01, 2e-4])
    x = nominal + sigma * np.array(values)
    root = np.random.default_rng(random.randrange(2**32)).normal(size=(8, 8))
    camera = Camera(CAMERAS["wang"], 1944, 2592, 2.2e-6, x)
    before = Calibration("ÄT-1", serial, camera, np.eye(3), root @ root.T, {"a": "b"}, {"q": 1})
    path = tmp_path_factory.mktemp("c") / "c.json"
    save(before, path)
    after = load(path)
    assert np.array_equal(after.camera.parameters, x)
    assert np.array_equal(after.covariance, before.covariance)
    assert (after.sensor_id, after.serial) == ("ÄT-1", serial)
    assert (after.provenance, after.quality) == ({"a": "b"}, {"q": 1})


def test_covariance_is_reordered_to_the_parameters(tmp_path):
    names = list(CAMERAS["wang"].parameter_names)
    matrix = np.diag(np.arange(1.0, 9.0))
    order = names[::-1]
    document = MINIMAL | {"covariance": {"parameters": order, "matrix": matrix.tolist()}}
    found = load(write(tmp_path / "c.json", document))
    assert np.diag(found.covariance).tolist() == list(range(8, 0, -1))


BROKEN = [
    ("", "not JSON"),
    ("[]", "top level"),
    ({"schema": "stcal.calibration/2"}, "this version reads"),
    (MINIMAL | {"serial": -1}, "serial is -1"),
    (MINIMAL | {"serial": True}, "serial is True"),
    (MINIMAL | {"serial": 10**300}, "2147483647"),
    (
        MINIMAL
        | {
            "camera": MINIMAL["camera"]
            | {"parameters": MINIMAL["camera"]["parameters"] | {"m0_px": 1e250}}
        },
        "no directions",
    ),
    (
        MINIMAL
        | {
            "camera": MINIMAL["camera"]
            | {"parameters": MINIMAL["camera"]["parameters"] | {"g_y": 0.0}}
        },
        "no directions",
    ),
    (MINIMAL | {"sensor_id": 5}, "sensor_id"),
    (MINIMAL | {"camera": 1}, "camera is missing"),
    (MINIMAL | {"camera": MINIMAL["camera"] | {"model": "x"}}, "known models: wang"),
    (MINIMAL | {"camera": MINIMAL["camera"] | {"rows": 0}}, "camera.rows is 0"),
    (MINIMAL | {"camera": MINIMAL["camera"] | {"pixel_size_m": "a"}}, "pixel_size_m is 'a'"),
    (MINIMAL | {"camera": MINIMAL["camera"] | {"parameters": {"f_m": 1}}}, "g_y is missing"),
    (MINIMAL | {"c_sd": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "not a rotation"),
    (MINIMAL | {"c_sd": [[1, 0], [0, 1]]}, "3 x 3"),
    (MINIMAL | {"covariance": {"parameters": ["f_m"], "matrix": [[1]]}}, "does not name"),
    (MINIMAL | {"provenance": []}, "provenance is not an object"),
]


@pytest.mark.parametrize(("document", "message"), BROKEN)
def test_broken_files_are_named_with_the_reason(tmp_path, document, message):
    path = write(tmp_path / "broken.json", document)
    with pytest.raises(InputError, match=r"broken\.json") as caught:
        load(path)
    assert message in str(caught.value)
    assert caught.value.exit_code == 3


def test_all_errors_are_listed_at_once(tmp_path):
    document = MINIMAL | {"serial": "x", "c_sd": 5, "camera": MINIMAL["camera"] | {"cols": 1}}
    with pytest.raises(InputError) as caught:
        load(write(tmp_path / "c.json", document))
    for part in ("serial", "c_sd", "camera.cols"):
        assert part in str(caught.value)


def test_saving_nan_is_refused_and_leaves_the_old_file(tmp_path):
    path = write(tmp_path / "c.json", MINIMAL)
    good = load(path)
    with pytest.raises(ValueError, match="JSON compliant"):
        save(replace(good, c_sd=np.full((3, 3), np.nan)), path)
    assert load(path).serial == 1
    assert len(list(tmp_path.iterdir())) == 1


def test_the_samples_are_readable():
    for path in (ROOT / "sample_telemetry").glob("*.initial.json"):
        assert load(path).camera.model.name == "wang"
