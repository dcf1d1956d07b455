from dataclasses import replace

import numpy as np
import pytest
from conftest import simulation, st16_config, st16_matcher
from scipy.spatial.transform import Rotation

from stcal.calibration import Calibration
from stcal.errors import InputError
from stcal.execution import scheduler
from stcal.matching import Matcher
from stcal.pipeline.fit import fit_batch
from stcal.pipeline.validate import compare, validate

SIGMA = np.array([8e-6, 30.0, 30.0, 1e8, 1e3, 0.01, 0.01, 2e-4])
HASHES = {"baseline": "b" * 64, "candidate": "c" * 64}
PROVENANCE = {"parent_sha256": "a" * 64}


def fit(data, frames=None, matches="lost-in-space", matcher=None, initial=None, **kwargs):
    frames = data.calibration.frames if frames is None else frames
    return fit_batch(
        [frames], initial or data.initial, matcher or st16_matcher(), PROVENANCE, matches, **kwargs
    )


@pytest.mark.parametrize("number", [1, 2, 3, 4, 5, 6])
def test_the_fit_reaches_the_noise_on_held_out_data(number):
    data = simulation(number, 51, 300)
    result = fit(data)
    assert result.accepted, result.document["verdict"]
    compared = compare([data.validation.frames], data.initial, result.calibration, st16_matcher())
    truth = compare([data.validation.frames], data.true, result.calibration, st16_matcher())
    assert truth.sums[1].rms_rad <= 1.01 * truth.sums[0].rms_rad
    assert compared.fixed[1].sum() >= compared.fixed[0].sum()
    assert compared.stars[1].sum() >= compared.stars[0].sum()


@pytest.mark.parametrize("number", [2, 4])
def test_errors_are_consistent_with_the_covariance(number):
    data = simulation(number, 52, 300)
    found = fit(data).calibration
    error = found.camera.parameters - data.true.camera.parameters
    nees = error @ np.linalg.solve(found.covariance, error)
    assert 1.0 < nees < 26.1  # chi-square of 8 degrees of freedom, 0.1 and 99.9 %
    sd = np.sqrt(np.diag(found.covariance))
    assert (np.abs(error / sd) < 4.5).all()


@pytest.mark.parametrize("matches", ["telemetry", "guided"])
def test_every_start_of_the_first_cycle_ends_in_the_same_camera(matches):
    data = simulation(4, 53, 300)
    lost, other = fit(data).calibration, fit(data, matches=matches).calibration
    sd = np.sqrt(np.diag(lost.covariance))
    assert (np.abs(lost.camera.parameters - other.camera.parameters) < 0.1 * sd).all()


def test_a_fit_of_its_own_result_is_accepted():
    data = simulation(4, 53, 300)
    first = fit(data)
    again = fit(data, initial=first.calibration)
    assert again.accepted, again.document["verdict"]
    assert again.calibration.serial == first.calibration.serial + 1


def test_wrong_telemetered_matches_do_not_spoil_the_fit():
    data = simulation(5, 53, 300)
    frames = data.calibration.frames
    rng = np.random.default_rng(2)
    ids = frames.star_id.copy()
    hit = (rng.random(frames.n_stars) < 0.1) & (ids != 0)
    false = np.isin(frames.exposure_of_star, rng.choice(frames.n_exposures, 30, replace=False))
    hit |= false & (ids != 0)
    ids[hit] = rng.choice(st16_matcher().catalogue.star_id, int(hit.sum()))
    clean = fit(data).calibration
    result = fit(data, replace(frames, star_id=ids), matches="telemetry")
    assert result.accepted, result.document["verdict"]
    sd = np.sqrt(np.diag(clean.covariance))
    found = result.calibration.camera.parameters
    assert (np.abs(found - clean.camera.parameters) < 0.1 * sd).all()


def test_gross_centroids_and_false_matches_do_not_move_the_fit():
    data = simulation(4, 54, 300)
    frames = data.calibration.frames
    rng = np.random.default_rng(1)
    hit = rng.random(frames.n_stars) < 0.01
    row = frames.row_px + np.where(hit, rng.normal(0, 2.0, frames.n_stars) + 1.5, 0.0)
    clean, spoilt = fit(data).calibration, fit(data, replace(frames, row_px=row)).calibration
    sd = np.sqrt(np.diag(clean.covariance))
    assert (np.abs(clean.camera.parameters - spoilt.camera.parameters) < 1.5 * sd).all()


def test_the_document_is_whole_and_consistent():
    data = simulation(4, 54, 300)
    result = fit(data)
    document, found = result.document, result.calibration
    assert [p["name"] for p in document["parameters"]] == list(found.camera.parameter_names)
    for k, row in enumerate(document["parameters"]):
        assert row["fitted"] == found.camera.parameters[k]
        assert row["change_sigma"] == pytest.approx((row["fitted"] - row["initial"]) / SIGMA[k])
        assert row["sd"] == pytest.approx(np.sqrt(found.covariance[k, k]))
    assert document["settled"]
    assert 2 <= len(document["cycles"]) <= st16_config().fit.maximum_cycles
    assert document["cycles"][-1]["matched_stars"] > document["cycles"][0]["matched_stars"]
    assert document["rms_urad"]["fitted"] < 0.3 * document["rms_urad"]["initial"]
    assert document["condition"]["scaled"] < document["condition"]["raw"] / 1e6
    assert np.diag(np.array(document["correlation"])) == pytest.approx(1.0)
    assert "observable" in document["observability"]
    assert found.serial == data.initial.serial + 1
    assert found.provenance == PROVENANCE
    assert found.quality["verdict"]["accepted"]
    after = np.hypot(document["field"]["after_row_px"], document["field"]["after_col_px"])
    before = np.hypot(document["field"]["before_row_px"], document["field"]["before_col_px"])
    assert np.median(after) < 0.2 * np.median(before)


def test_fragments_and_workers_do_not_change_the_answer():
    data = simulation(4, 55, 200)
    frames = data.calibration.frames
    parts = [frames.take(np.arange(a, min(a + 64, frames.n_frames))) for a in range(0, 200, 64)]
    alone = fit_batch(parts, data.initial, st16_matcher(), PROVENANCE)
    with scheduler(2) as threads:
        shared = fit_batch(parts, data.initial, st16_matcher(), PROVENANCE, mapper=threads)
    assert np.array_equal(alone.calibration.camera.parameters, shared.calibration.camera.parameters)
    assert np.array_equal(alone.calibration.c_sd, shared.calibration.c_sd)
    whole = fit(data).calibration
    sd = np.sqrt(np.diag(whole.covariance))
    assert (np.abs(whole.camera.parameters - alone.calibration.camera.parameters) < 1e-3 * sd).all()


def moved_principal_point(data, shift_px):
    """A calibration whose principal point is off by many pixels, and C_SD not identity."""
    x = data.true.camera.parameters.copy()
    x[1] += shift_px
    x[2] -= shift_px / 2
    c_sd = Rotation.from_rotvec([0.4, -0.1, 0.7]).as_matrix()
    camera = data.true.camera.with_parameters(x)
    return Calibration(data.initial.sensor_id, 3, camera, c_sd)


def test_c_sd_nulls_the_attitude_offset_of_a_principal_point_moved_by_290_px():
    """The wrong sign or order doubles the offset of 40 mrad instead of removing it."""
    data = simulation(2, 56, 300)
    initial = moved_principal_point(data, 290.0)
    loose = st16_config().model_copy(
        update={
            "fit": st16_config().fit.model_copy(update={"maximum_change_sigma": 60.0}),
            "matching": st16_config().matching.model_copy(
                update={"pair_tolerance_urad": 2500.0, "star_tolerance_urad": 1500.0}
            ),
        }
    )
    matcher = Matcher(st16_matcher().catalogue, loose)
    result = fit(data, matcher=matcher, initial=initial)
    assert result.accepted, result.document["verdict"]
    offset = np.linalg.norm(result.document["c_sd"]["offset_arcsec"])
    assert offset > 6000  # 290 px are 40 mrad, 8200 arcsec
    document = validate([data.validation.frames], initial, result.calibration, matcher, HASHES)
    left = np.array(document["attitude_offset_arcsec"])
    spread = np.array(document["attitude_spread_arcsec"])
    assert (np.abs(left) < spread).all()
    assert np.linalg.norm(left) < 0.01 * offset


@pytest.mark.parametrize("number", [5, 6])
def test_c_sd_is_made_with_the_fitted_camera_itself(number):
    """m0 and a2, n0 and a1 trade freely here: the last step alone turns D by many arcsec."""
    data = simulation(number, 58, 300)
    result = fit(data)
    document = validate(
        [data.calibration.frames], data.initial, result.calibration, st16_matcher(), HASHES
    )
    left = np.array(document["attitude_offset_arcsec"])
    assert (np.abs(left) < 0.1 * np.array(document["attitude_spread_arcsec"])).all()


def refusals(result):
    assert not result.accepted
    assert result.calibration is None
    return " ".join(result.document["verdict"]["reasons"])


def test_too_few_frames_are_refused():
    data = simulation(4, 57, 60)
    few = data.calibration.frames.take(np.arange(12))
    assert "frames identified" in refusals(fit(data, few))


def test_frames_without_stars_are_refused():
    data = simulation(4, 57, 60)
    frames = data.calibration.frames
    empty = replace(
        frames,
        star_offsets=np.zeros(frames.n_exposures + 1, int),
        **{k: getattr(frames, k)[:0] for k in ("row_px", "col_px", "intensity", "star_id")},
    )
    assert "0 frames identified" in refusals(fit(data, empty))


def test_poor_coverage_is_refused():
    data = simulation(4, 57, 60)
    frames = data.calibration.frames
    near = (np.abs(frames.row_px - 972) < 350) & (np.abs(frames.col_px - 1296) < 450)
    counts = np.bincount(frames.exposure_of_star[near], minlength=frames.n_exposures)
    inner = replace(
        frames,
        star_offsets=np.concatenate(([0], np.cumsum(counts))),
        **{k: getattr(frames, k)[near] for k in ("row_px", "col_px", "intensity", "star_id")},
    )
    rules = st16_config().matching.model_copy(update={"minimum_matches": 3, "false_alarm": 0.05})
    gates = st16_config().fit.model_copy(
        update={"minimum_frames": 1, "minimum_stars": 9, "minimum_stars_per_exposure": 3}
    )
    loose = st16_config().model_copy(update={"matching": rules, "fit": gates})
    matcher = Matcher(st16_matcher().catalogue, loose)
    assert "of the detector" in refusals(fit(data, inner, matcher=matcher))


def test_an_implausible_change_and_a_broken_noise_model_are_refused():
    data = simulation(4, 57, 120)
    gates = st16_config().fit.model_copy(update={"maximum_change_sigma": 5.0})
    strict = st16_config().model_copy(update={"fit": gates})
    text = refusals(fit(data, matcher=Matcher(st16_matcher().catalogue, strict)))
    assert "f_m moved by 9" in text
    quiet = st16_config().model_copy(
        update={"noise": st16_config().noise.model_copy(update={"sd_px": 0.02})}
    )
    text = refusals(fit(data, matcher=Matcher(st16_matcher().catalogue, quiet)))
    assert "times the noise model" in text


def test_an_unsettled_fit_is_refused():
    data = simulation(2, 57, 120)
    gates = st16_config().fit.model_copy(update={"maximum_cycles": 1})
    hasty = st16_config().model_copy(update={"fit": gates})
    assert "did not settle" in refusals(fit(data, matcher=Matcher(st16_matcher().catalogue, hasty)))


def test_a_degenerate_fit_is_refused():
    data = simulation(5, 57, 120)
    gates = st16_config().fit.model_copy(update={"maximum_condition": 20.0})
    strict = st16_config().model_copy(update={"fit": gates})
    text = refusals(fit(data, matcher=Matcher(st16_matcher().catalogue, strict)))
    assert "degenerate" in text


def test_a_calibration_of_another_detector_is_bad_input():
    data = simulation(4, 57, 60)
    other = replace(data.initial, camera=replace(data.initial.camera, rows=1024))
    with pytest.raises(InputError, match="detector 1024 x 2592"):
        fit(data, initial=other)
