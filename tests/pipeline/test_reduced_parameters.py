"""``--parameters``: some are estimated, the others keep their initial values exactly."""

import numpy as np
import pytest
from conftest import simulation, st16_matcher

from stcal.errors import UsageError
from stcal.pipeline.filtering import Variant
from stcal.pipeline.fit import fit_batch
from stcal.pipeline.parameters import embedded, estimated_indices
from stcal.pipeline.sequential import fit_sequential
from stcal.pipeline.validate import compare

NAMES = ("f_m", "m0_px", "n0_px", "b4_per_m4", "b2_per_m2", "a1_rad", "a2_rad", "g_y")
# Samaan's set, of Enright 2018 section III-C.
REDUCED = ("f_m", "m0_px", "n0_px")
PROVENANCE = {"parent_sha256": "a" * 64}


def fit(how, data, parameters, initial=None):
    frames, initial = [data.calibration.frames], initial or data.initial
    if how == "batch":
        return fit_batch(frames, initial, st16_matcher(), PROVENANCE, parameters=parameters)
    variant = Variant(method=how, parameters=parameters)
    return fit_sequential(frames, initial, st16_matcher(), PROVENANCE, variant)


@pytest.mark.parametrize("how", ["batch", "sqrf", "ukf", "smoother"])
@pytest.mark.parametrize("estimated", [REDUCED, ("g_y", "f_m")])
def test_held_parameters_keep_their_values(how, estimated):
    data = simulation(3, 51, 200)
    result = fit(how, data, estimated)
    document = result.document
    assert document["estimated_parameters"] == [n for n in NAMES if n in estimated]
    rows = {row["name"]: row for row in document["parameters"]}
    assert list(rows) == list(NAMES)
    for name, value in zip(NAMES, data.initial.camera.parameters, strict=True):
        row = rows[name]
        assert row["initial"] == value
        if name in estimated:
            assert row["fitted"] != value
            assert row["sd"] > 0
        else:
            assert row["fitted"] == value
            assert row["change_sigma"] == 0.0
            assert row["sd"] is None
    assert len(document["singular_values"]) == len(estimated)
    assert document["condition"]["scaled"] < 1e3


@pytest.mark.parametrize("how", ["batch", "sqrf"])
def test_the_calibration_says_what_was_held(how):
    """Zero variance, and nothing correlated with it."""
    data = simulation(3, 51, 200)
    found = fit(how, data, REDUCED).calibration
    assert found is not None
    free = np.isin(NAMES, REDUCED)
    assert np.array_equal(found.camera.parameters[~free], data.initial.camera.parameters[~free])
    assert not found.covariance[~free].any()
    assert not found.covariance[:, ~free].any()
    block = found.covariance[np.ix_(free, free)]
    assert (np.linalg.eigvalsh(block / np.sqrt(np.outer(np.diag(block), np.diag(block)))) > 0).all()


def test_batch_and_filter_agree_on_the_reduced_set():
    """From the true camera: the others are right then, and the answer is the truth."""
    data = simulation(3, 51, 200)
    batch, filtered = (fit(how, data, REDUCED, data.true).calibration for how in ("batch", "sqrf"))
    sd = np.sqrt(np.diag(batch.covariance))[:3]
    difference = (batch.camera.parameters - filtered.camera.parameters)[:3]
    assert np.abs(difference / sd).max() < 0.1
    error = (batch.camera.parameters - data.true.camera.parameters)[:3]
    assert np.abs(error / sd).max() < 4.5
    np.testing.assert_allclose(np.sqrt(np.diag(filtered.covariance))[:3], sd, rtol=0.05)


def test_the_full_set_serves_better_than_the_reduced_one():
    data = simulation(3, 51, 200)
    for how in ("batch", "sqrf"):
        full, reduced = (fit(how, data, names).calibration for names in (None, REDUCED))
        sums = compare([data.validation.frames], reduced, full, st16_matcher()).sums
        assert 1.02 * sums[1].rms_rad < sums[0].rms_rad


def test_all_by_name_is_all():
    data = simulation(3, 51, 200)
    for how in ("batch", "sqrf"):
        named, every = fit(how, data, NAMES), fit(how, data, None)
        assert np.array_equal(
            named.calibration.camera.parameters, every.calibration.camera.parameters
        )


def test_the_order_of_the_names_does_not_matter():
    data = simulation(3, 51, 200)
    one, other = (fit("sqrf", data, names) for names in (REDUCED, REDUCED[::-1]))
    assert np.array_equal(one.calibration.covariance, other.calibration.covariance)


@pytest.mark.parametrize("how", ["batch", "sqrf"])
@pytest.mark.parametrize(
    ("names", "message"),
    [
        (("f_m", "zoom", "blur"), "zoom, blur; its parameters are f_m, m0_px"),
        (("f_m", "f_m"), "each parameter once"),
        (("",), "no parameter of the camera"),
        ((), "at least one"),
    ],
)
def test_names_that_are_none_are_refused(how, names, message):
    with pytest.raises(UsageError, match=message):
        fit(how, simulation(3, 51, 200), names)


def test_places_rise_and_cover():
    assert estimated_indices(None, NAMES).tolist() == list(range(8))
    assert estimated_indices(("g_y", "f_m"), NAMES).tolist() == [0, 7]
    full = embedded(np.array([[4.0, 1.0], [1.0, 9.0]]), np.array([1, 3]), 4)
    assert full[1, 3] == full[3, 1] == 1.0
    assert full[3, 3] == 9.0
    assert np.count_nonzero(full) == 4
