"""What the study computes by itself, against the core's results and against plain loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import ROOT, simulation, st16_matcher

from stcal.constants import URAD
from stcal.matching import match
from stcal.pipeline.fit import fit_batch
from stcal.pipeline.validate import compare
from stcal.simulate import load_scenario
from stcal.studies.enright_history import (
    _aggregate,
    ends,
    radial_difference,
    shown_frames,
    tail_and_aggregate,
)
from stcal.studies.enright_runs import FILTERS, fit_filters
from stcal.studies.evaluation import evaluate, pairs_of, rms_urad
from stcal.studies.scenarios import shortened


@pytest.fixture(scope="module")
def sensor():
    """A short run of Sensor 4 with its batch camera."""
    simulated, matcher = simulation(4, 1, 60), st16_matcher()
    fitted = fit_batch([simulated.calibration.frames], simulated.initial, matcher, {})
    assert fitted.calibration is not None
    return simulated, matcher, fitted.calibration


def test_two_cameras_compare_as_in_a_validation(sensor):
    simulated, matcher, fitted = sensor
    initial, frames = simulated.initial, simulated.validation.frames
    # Every fifth frame is in eclipse: it counts for nothing.
    frames = replace(frames, eclipse=np.arange(frames.n_frames) % 5 == 0)
    cameras = {"raw": initial.camera, "batch": fitted.camera}
    found = evaluate(frames, cameras, initial.c_sd, matcher)
    expected = compare([frames], initial, fitted, matcher)
    counted = expected.counted.sum()
    assert found["frames"] == counted == 24
    assert found["pairs_from"] == "batch" == expected.pairs_from.replace("candidate", "batch")
    assert found["pairs"] == expected.sums[1].pairs.sum()
    for k, name in enumerate(("raw", "batch")):
        camera = found["cameras"][name]
        assert camera["rms_urad"] == pytest.approx(expected.sums[k].rms_rad / URAD, rel=1e-12)
        assert camera["availability"] == expected.fixed[k].sum() / counted
        assert camera["matched_stars"] == expected.stars[k].sum()
    ratio = expected.stars[1].sum() / expected.stars[0].sum()
    assert found["cameras"]["batch"]["matched_star_ratio"] == ratio > 1.5
    # Over its own pairs, those that it can identify, the initial camera errs less.
    raw, batch = (found["cameras"][name] for name in ("raw", "batch"))
    assert raw["own_rms_urad"] < 0.8 * raw["rms_urad"]
    assert batch["own_rms_urad"] == batch["rms_urad"]


def test_the_true_camera_gives_no_pairs(sensor):
    simulated, matcher, _ = sensor
    frames, initial = simulated.validation.frames, simulated.initial
    cameras = {"raw": initial.camera, "true": simulated.true.camera}
    found = evaluate(frames, cameras, initial.c_sd, matcher)
    assert found["pairs_from"] == "raw"
    assert found["cameras"]["raw"]["rms_urad"] == found["cameras"]["raw"]["own_rms_urad"]


def test_aggregate_takes_each_frame_with_its_own_estimate(sensor):
    simulated, matcher, fitted = sensor
    frames, camera = simulated.calibration.frames, fitted.camera
    arcs = pairs_of(match(frames, camera, fitted.c_sd, matcher), matcher)
    same = np.tile(camera.parameters, (frames.n_frames, 1))
    assert _aggregate(frames, arcs, camera, same) == rms_urad(arcs.departures(camera))
    random = np.random.default_rng(1)
    history = same * (1.0 + 1e-3 * random.normal(size=same.shape))
    frame = frames.exposure_of_star[arcs.selection.star[arcs.pair_i]] // 2
    by_frame = [
        arcs.departures(camera.with_parameters(history[k]))[frame == k]
        for k in range(frames.n_frames)
    ]
    expected = rms_urad(np.concatenate(by_frame))
    assert _aggregate(frames, arcs, camera, history) == pytest.approx(expected, rel=1e-12)


def test_filters_are_the_papers_three(sensor):
    simulated, matcher, fitted = sensor
    frames, initial = simulated.calibration.frames, simulated.initial
    found = fit_filters(frames, initial, matcher)
    variants = {name: d["sequential"]["variant"] for name, d in found.documents.items()}
    assert [v["rematch"] for v in variants.values()] == [True, True, False]
    noise = dict.fromkeys(initial.camera.parameter_names, 0.05)
    assert [v["process_noise"] for v in variants.values()] == [noise, {}, noise]
    assert {v["method"] for v in variants.values()} == {"sqrf"}
    assert not any(v["shadow"] for v in variants.values())
    # Kept matches are the initial camera's.
    kept = found.runs["no_refit"].history
    assert (kept.matched == kept.matched_baseline).all()
    end = ends(found, found)
    errors = tail_and_aggregate(frames, found, fitted.camera, matcher)
    for name in FILTERS:
        assert end[name]["lab"] == end[name]["batch"] == found.cameras[name].parameters.tolist()
    arcs = pairs_of(match(frames, fitted.camera, fitted.c_sd, matcher), matcher)
    last = rms_urad(arcs.departures(found.cameras["no_q"]))
    assert errors["no_q"]["tail_urad"][-1] == pytest.approx(last, rel=1e-12)
    assert errors["pairs"] == len(arcs)


def test_radial_difference_is_that_of_the_model(st16_camera):
    x = st16_camera.parameters
    other = x * np.array([1.001, 1.1, 0.9, 0.7, 1.2, 2.0, 3.0, 1.01])
    cameras = {"batch": st16_camera, "q": st16_camera.with_parameters(other)}
    found = radial_difference(cameras)
    rho = np.array(found["radius_px"])
    assert (rho[0], rho[-1]) == (0.0, 1600.0)

    def slope(f, b4, b2):
        r = rho * st16_camera.pixel_size_m
        return r * (1.0 + b2 * r**2 + b4 * r**4) / f

    expected = slope(*other[[0, 3, 4]]) - slope(*x[[0, 3, 4]])
    expected *= x[0] / st16_camera.pixel_size_m
    # The rest of the camera (principal point, tilt, aspect) isn't radial.
    np.testing.assert_allclose(found["q"], expected, rtol=0, atol=1e-10)
    assert "batch" not in found


def test_a_longer_focal_length_sees_stars_farther_in(st16_camera):
    longer = st16_camera.parameters.copy()
    longer[0] *= 1.001
    cameras = {"batch": st16_camera, "q": st16_camera.with_parameters(longer)}
    assert (np.array(radial_difference(cameras)["q"])[1:] < 0).all()


@pytest.mark.parametrize("count", [1, 7, 20, 21, 400, 5000])
def test_shown_frames_hold_the_first_and_the_last(count):
    shown = shown_frames(count)
    assert (np.diff(shown) > 0).all()
    first = min(count, 20)
    assert shown[:first].tolist() == list(range(1, first + 1))
    assert shown[-1] == count
    assert len(shown) <= 120


def test_a_shortened_scenario_keeps_the_shares_of_its_segments():
    scenario = load_scenario(ROOT / "configs" / "scenarios" / "st16-6.toml")
    short = shortened(scenario, 80)
    assert [s.frames for s in scenario.calibration.segments] == [150, 250]
    assert [s.frames for s in short.calibration.segments] == [30, 50]
    assert [s.frames for s in short.validation.segments] == [16, 24]
    assert sum(s.frames for s in shortened(scenario, 20).validation.segments) == 20
    assert shortened(scenario, None) is scenario
