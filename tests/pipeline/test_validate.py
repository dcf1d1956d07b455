from dataclasses import replace

import numpy as np
import pytest
from conftest import simulation, st16_config, st16_matcher
from scipy.spatial.transform import Rotation

from stcal.matching import match
from stcal.pipeline.validate import compare, validate
from stcal.residuals import choose_arcs, select_stars

HASHES = {"baseline": "b" * 64, "candidate": "c" * 64, "telemetry_sha256": "d" * 64}


@pytest.fixture(scope="module")
def data():
    return simulation(4, 61, 100)


def test_the_truth_beats_the_initial_calibration(data):
    frames = data.validation.frames
    document = validate([frames], data.initial, data.true, st16_matcher(), HASHES)
    assert document["verdict"]["accepted"]
    assert document["availability"]["candidate"] >= document["availability"]["baseline"]
    assert document["matched_star_ratio"] > 1.2
    rms = document["common_pair_rms_urad"]
    assert rms["candidate"] < 0.3 * rms["baseline"]
    assert document["pairs_from"] == "candidate"
    assert document["frames"] == frames.n_frames
    assert document["counted_frames"] == int(frames.counts_for_availability.sum())
    low, high = rms["interval"]["candidate"]
    assert low < rms["candidate"] < high


def test_a_worse_candidate_is_refused(data):
    document = validate([data.validation.frames], data.true, data.initial, st16_matcher(), HASHES)
    assert not document["verdict"]["accepted"]
    text = " ".join(document["verdict"]["reasons"])
    assert "matched stars worse" in text
    assert "common-pair RMS worse" in text
    assert document["pairs_from"] == "baseline"


def test_equal_calibrations_compare_equal(data):
    document = validate([data.validation.frames], data.true, data.true, st16_matcher(), HASHES)
    assert document["matched_star_ratio"] == 1.0
    assert document["rms_ratio"] == 1.0
    assert document["verdict"] == {"accepted": True, "reasons": [], "notes": []}


def test_telemetry_of_the_fit_itself_is_noted(data):
    span = {"from": "2014-01-01T00:00:00.000Z", "to": "2015-01-01T00:00:00.000Z"}
    fitted = replace(data.true, provenance=span)
    document = validate([data.validation.frames], data.true, fitted, st16_matcher(), HASHES)
    assert "held-out" in document["verdict"]["notes"][0]
    earlier = replace(data.true, provenance=span | {"to": "2014-01-02T00:00:00.000Z"})
    document = validate([data.validation.frames], data.true, earlier, st16_matcher(), HASHES)
    assert document["verdict"]["notes"] == []


def test_an_attitude_jump_is_noted(data):
    turn = Rotation.from_rotvec([3e-4, 0, 0]).as_matrix()
    turned = replace(data.true, c_sd=turn @ data.true.c_sd)
    document = validate([data.validation.frames], data.true, turned, st16_matcher(), HASHES)
    assert "attitudes change by +61.9" in document["verdict"]["notes"][0]


def test_a_small_loss_is_noted_but_not_refused(data):
    """A camera off by a few sd loses under 1 % of RMS, significantly or not."""
    x = data.true.camera.parameters.copy()
    x[0] *= 1.0 - 4e-5
    near = replace(data.true, camera=data.true.camera.with_parameters(x))
    document = validate([data.validation.frames], data.true, near, st16_matcher(), HASHES)
    assert 1.0 < document["rms_ratio"] < 1.01
    assert document["verdict"]["accepted"]
    assert any("common-pair RMS" in note for note in document["verdict"]["notes"])


def test_too_few_frames_are_refused(data):
    few = data.validation.frames.take(np.arange(5))
    document = validate([few], data.initial, data.true, st16_matcher(), HASHES)
    assert not document["verdict"]["accepted"]
    assert "at least 20 needed" in document["verdict"]["reasons"][0]


def test_availability_counts_frames_outside_eclipse_and_intrusion(data):
    frames = data.validation.frames
    dark = np.arange(frames.n_frames) % 7 == 0
    frames = replace(frames, eclipse=dark, intrusion=np.roll(dark, 1))
    document = validate([frames], data.initial, data.true, st16_matcher(), HASHES)
    counted = frames.counts_for_availability
    assert document["counted_frames"] == counted.sum() < frames.n_frames
    for name, one in (("baseline", data.initial), ("candidate", data.true)):
        matched = match(frames, one.camera, one.c_sd, st16_matcher())
        expected = matched.frame_solved[counted].mean()
        assert document["availability"][name] == pytest.approx(expected)
        stars = matched.matches_per_exposure.reshape(-1, 2).sum(axis=1)
        assert document["matched_stars"][name] == stars[counted].sum()


def test_the_common_pairs_are_the_larger_set_under_both_cameras(data):
    frames = data.validation.frames.take(data.validation.frames.counts_for_availability)
    compared = compare([frames], data.initial, data.true, st16_matcher())
    assert compared.pairs_from == "candidate"
    matched = match(frames, data.true.camera, data.true.c_sd, st16_matcher())
    arcs = choose_arcs(select_stars(matched, st16_config().noise, 4))
    for sums, one in zip(compared.sums, (data.initial, data.true), strict=True):
        assert sums.pairs.sum() == len(arcs)
        expected = np.sqrt((arcs.departures(one.camera) ** 2).mean())
        assert sums.rms_rad == pytest.approx(expected, rel=1e-12)


def test_parts_give_the_same_figures_as_the_whole(data):
    frames = data.validation.frames
    whole = validate([frames], data.initial, data.true, st16_matcher(), HASHES)
    parts = [frames.take(np.arange(0, 20)), frames.take(np.arange(20, frames.n_frames))]
    split = validate(parts, data.initial, data.true, st16_matcher(), HASHES)
    for key in ("availability", "matched_stars", "matched_star_ratio", "pairs"):
        assert whole[key] == split[key]
    assert whole["common_pair_rms_urad"]["candidate"] == pytest.approx(
        split["common_pair_rms_urad"]["candidate"], rel=1e-12
    )
