"""Sequential fits against the batch, against each other and against the truth."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from conftest import simulation, st16_config, st16_matcher
from scipy.optimize import least_squares

from stcal.errors import InputError, UsageError
from stcal.estimators.batch import covariance_from
from stcal.execution import scheduler, serial
from stcal.matching import match
from stcal.matching.identify import rematch_given
from stcal.pipeline.cycles import run_cycles
from stcal.pipeline.filter_run import filter_fragment, run_filter
from stcal.pipeline.filtering import Variant, make_filter, process_noise_of
from stcal.pipeline.fit import fit_batch
from stcal.pipeline.pieces import pieces_of
from stcal.pipeline.scratch import MemoryScratch
from stcal.pipeline.sequential import fit_sequential
from stcal.pipeline.validate import compare
from stcal.residuals import ARCLENGTH, select_stars

PROVENANCE = {"parent_sha256": "a" * 64}
METHODS = ["ekf", "sqrf", "ukf", "smoother"]


def fit(data, variant=None, frames=None, **kwargs):
    frames = data.calibration.frames if frames is None else frames
    initial = kwargs.pop("initial", data.initial)
    matcher = kwargs.pop("matcher", st16_matcher())
    return fit_sequential([frames], initial, matcher, PROVENANCE, variant or Variant(), **kwargs)


def in_state(chosen, data, camera):
    """A camera as the filter's state: departures from the initial one in sigma."""
    return (camera.parameters - data.initial.camera.parameters) / chosen.model.scale


@cache
def batch_with_its_matches(number, seed):
    """The batch's last cycle, and its matches as a filter's fixed ones."""
    data, matcher = simulation(number, seed, 300), st16_matcher()
    frames = data.calibration.frames
    scratch = MemoryScratch()
    cycles, _ = run_cycles(
        pieces_of([frames]), data.initial, matcher, "lost-in-space", ARCLENGTH, np.arange(8),
        scratch, serial, lambda cycle: None,
    )  # fmt: skip
    last = cycles[-1]
    (star,) = scratch.get(f"{last.name} matches", 0)
    given = rematch_given(frames, data.initial.camera, matcher.catalogue, star)
    sd = np.sqrt(np.diag(covariance_from(last.fitted.solution.information))) * last.noise_scale
    return data, last.fitted.camera, sd, given


def filtered(method, data, given):
    variant = Variant(method=method, rematch=False, shadow=False)
    chosen = make_filter(variant, data.initial, st16_matcher())
    return chosen, run_filter(chosen, [given], chosen.start)


@pytest.mark.parametrize(
    ("number", "seed"), [(1, 51), (2, 51), (2, 52), (3, 51), (4, 51), (6, 51), (6, 52)]
)
def test_filters_agree_with_the_batch_on_the_same_matches(number, seed):
    data, camera, sd, given = batch_with_its_matches(number, seed)
    for method in METHODS:
        chosen, run = filtered(method, data, given)
        assert not run.history.event.any()
        departure = (run.state.x - in_state(chosen, data, camera)) / sd
        assert np.abs(departure).max() < 0.1, method
        np.testing.assert_allclose(np.sqrt(np.diag(chosen.covariance(run.state))), sd, rtol=0.05)


def test_a_degenerate_sensor_agrees_within_its_sd():
    """Sensor 5, condition 1000: a filter can't unlearn what it took from the first frames."""
    data, camera, sd, given = batch_with_its_matches(5, 51)
    for method, limit in (("sqrf", 1.0), ("smoother", 0.05)):
        chosen, run = filtered(method, data, given)
        departure = (run.state.x - in_state(chosen, data, camera)) / sd
        assert np.abs(departure).max() < limit, method


def test_linear_filters_agree_to_rounding_when_linearised_alike():
    data, camera, sd, given = batch_with_its_matches(4, 51)
    found = []
    for method in ("ekf", "sqrf", "smoother"):
        chosen = make_filter(Variant(method=method, rematch=False), data.initial, st16_matcher())
        at = in_state(chosen, data, camera)
        chosen = replace(
            chosen,
            model=chosen.model._replace(linearise_at=at),
            rules=chosen.rules._replace(fixed=True),
        )
        state, history, _ = filter_fragment(chosen, given, replace(chosen.start, sloped_at=at))
        found.append((state.x, np.sqrt(np.diag(chosen.covariance(state))), history.nis))
    for x, spread, nis in found[1:]:
        assert np.abs((x - found[0][0]) / sd).max() < 1e-6
        np.testing.assert_allclose(spread, found[0][1], rtol=1e-6)
        np.testing.assert_allclose(nis, found[0][2], rtol=1e-6)


@pytest.mark.parametrize("number", [2, 4])
@pytest.mark.parametrize("frames", [1, 5, 50, 120])
def test_the_window_makes_the_most_probable_state(number, frames):
    """Against a peer that minimises residuals and prior of all frames together; beyond the window
    of 50 frames, too."""
    data, _, _, given = batch_with_its_matches(number, 51)
    part = given.take(np.arange(frames))
    chosen, run = filtered("sqrf", data, part)
    scale, start = chosen.model.scale, data.initial.camera
    stars = select_stars(part, st16_config().noise, st16_config().fit.minimum_stars_per_exposure)
    bound = ARCLENGTH.bind(stars, start.with_parameters(run.camera_parameters))

    def rows(x):
        return bound.linearise(start.with_parameters(start.parameters + x * scale))

    peer = least_squares(
        lambda x: np.concatenate([rows(x)[:, -1], x / 10.0]),
        run.state.x,
        lambda x: np.vstack([rows(x)[:, :-1] * scale, np.eye(8) / 10.0]),
        method="lm",
    )
    sd = np.sqrt(np.diag(np.linalg.inv(peer.jac.T @ peer.jac)))
    assert np.abs((run.state.x - peer.x) / sd).max() < 0.05
    found = np.sqrt(np.diag(chosen.covariance(run.state))) / run.history.noise_scale[-1]
    np.testing.assert_allclose(found, sd, rtol=0.02)


@pytest.mark.parametrize(("number", "method"), [(2, "sqrf"), (4, "ukf"), (5, "sqrf"), (6, "ukf")])
def test_the_fit_reaches_the_noise_on_held_out_data(number, method):
    data = simulation(number, 51, 300)
    result = fit(data, Variant(method=method))
    assert result.calibration is not None, result.document["verdict"]
    assert not result.document["sequential"]["events"]
    truth = compare([data.validation.frames], data.true, result.calibration, st16_matcher())
    assert truth.sums[1].rms_rad <= 1.01 * truth.sums[0].rms_rad
    change = compare([data.validation.frames], data.initial, result.calibration, st16_matcher())
    assert change.fixed[1].sum() >= change.fixed[0].sum()
    assert change.stars[1].sum() >= change.stars[0].sum()


@pytest.mark.parametrize("number", [4, 6])
def test_lab_and_batch_start_end_alike(number):
    """Enright's Fig 3a and 3b."""
    data = simulation(number, 51, 300)
    batch = fit_batch([data.calibration.frames], data.initial, st16_matcher(), PROVENANCE)
    sd = np.sqrt(np.diag(batch.calibration.covariance))
    for method in ("sqrf", "ukf"):
        lab = fit(data, Variant(method=method)).calibration.camera.parameters
        again = fit(data, Variant(method=method), initial=batch.calibration)
        assert again.calibration.serial == batch.calibration.serial + 1
        assert np.abs((again.calibration.camera.parameters - lab) / sd).max() < 0.5
        assert np.abs((lab - batch.calibration.camera.parameters) / sd).max() < 0.5


def test_fragments_and_workers_do_not_change_the_answer():
    data = simulation(4, 55, 200)
    frames = data.calibration.frames
    parts = [frames.take(np.arange(a, min(a + 64, frames.n_frames))) for a in range(0, 200, 64)]
    whole = fit(data)
    with scheduler(2) as threads:
        split = fit_sequential(
            parts, data.initial, st16_matcher(), PROVENANCE, Variant(), mapper=threads
        )
    for name in ("x", "sd", "nis", "innovation", "matched", "iterations", "noise_scale"):
        assert np.array_equal(getattr(whole.history, name), getattr(split.history, name)), name
    assert np.array_equal(whole.calibration.camera.parameters, split.calibration.camera.parameters)


def test_without_rematching_the_baselines_matches_are_used():
    data = simulation(4, 55, 200)
    still, anew = (fit(data, Variant(rematch=rematch)) for rematch in (False, True))
    assert np.array_equal(still.history.matched, still.history.matched_baseline)
    assert np.array_equal(still.history.fixed, still.history.fixed_baseline)
    assert anew.history.matched.sum() > 1.5 * anew.history.matched_baseline.sum()
    assert still.document["matches"] == "lost-in-space, baseline only"
    expected = match(
        data.calibration.frames, data.initial.camera, data.initial.c_sd, st16_matcher()
    )
    assert np.array_equal(still.runs["constant"].matched[0].star, expected.star)


@pytest.mark.parametrize("matches", ["guided", "telemetry"])
def test_other_matches_end_in_the_same_camera(matches):
    data = simulation(4, 53, 300)
    lost = fit(data, Variant(rematch=matches == "guided"))
    other = fit(data, Variant(matches=matches, rematch=matches == "guided"))
    sd = np.sqrt(np.diag(lost.calibration.covariance))
    difference = lost.calibration.camera.parameters - other.calibration.camera.parameters
    assert np.abs(difference / sd).max() < 1.0


def blind(frames, first, last):
    """The frames with no detections in some of them."""
    frame = frames.exposure_of_star // 2
    seen = (frame < first) | (frame >= last)
    counts = np.bincount(frames.exposure_of_star[seen], minlength=frames.n_exposures)
    return replace(
        frames,
        star_offsets=np.concatenate(([0], np.cumsum(counts))),
        **{k: getattr(frames, k)[seen] for k in ("row_px", "col_px", "intensity", "star_id")},
    )


@pytest.mark.parametrize("method", ["ekf", "sqrf", "ukf"])
def test_process_noise_is_a_random_walk_per_time(method):
    """Without stars the variance grows with the hours, whatever the number of frames."""
    data = simulation(4, 55, 200)
    frames = blind(data.calibration.frames, 120, 180)
    noise = {"f_m": 0.5, "a1_rad": 0.2}
    chosen = make_filter(Variant(method=method, process_noise=noise), data.initial, st16_matcher())
    baseline = match(frames, data.initial.camera, data.initial.c_sd, st16_matcher())
    _, history, _ = filter_fragment(chosen, baseline, chosen.start)
    hours = (history.t_tai_ns - history.t_tai_ns[119]) / 3.6e12
    grown = history.sd**2 - history.sd[119] ** 2
    for name, sigma in {**noise, "g_y": 0.0}.items():
        k = chosen.names.index(name)
        expected = sigma**2 * hours[120:180]
        np.testing.assert_allclose(grown[120:180, k], expected, rtol=1e-6, atol=1e-12)
    assert (history.arcs[120:180] == 0).all()
    assert np.isnan(history.nis[120:180]).all()
    assert np.array_equal(history.x[119:180], np.broadcast_to(history.x[119], (61, 8)))
    assert (history.sd[182] < history.sd[179]).any()


def test_the_configured_process_noise_names_every_parameter():
    section = st16_config().sequential.model_copy(update={"process_noise": {"f_m": 1.5}})
    config = st16_config().model_copy(update={"sequential": section})
    assert process_noise_of(config, ["f_m", "g_y"]) == {
        "f_m": 1.5, "g_y": section.process_noise_sigma,
    }  # fmt: skip


def test_the_document_is_whole_and_consistent():
    data = simulation(4, 54, 300)
    result = fit(data)
    document, history, found = result.document, result.history, result.calibration
    assert [p["fitted"] for p in document["parameters"]] == found.camera.parameters.tolist()
    run = result.runs["constant"]
    np.testing.assert_allclose(run.camera_parameters, found.camera.parameters, rtol=1e-15)
    sd = [p["sd"] for p in document["parameters"]]
    np.testing.assert_allclose(sd, history.sd[-1] * run.filter.model.scale, rtol=1e-9)
    np.testing.assert_allclose(sd, np.sqrt(np.diag(found.covariance)), rtol=1e-9)
    described = document["sequential"]
    used = history.arcs > 0
    assert described["frames"] == 300
    assert described["frames_updated"] == used.sum()
    assert described["stars_rejected"] == history.rejected.sum()
    innovations = described["innovations"]
    assert innovations["count"] == history.arcs.sum()
    assert innovations["per_arc"] == pytest.approx(history.nis[used].sum() / history.arcs.sum())
    squares = np.add.reduceat(history.innovation**2, np.cumsum(history.innovations)[:-1])
    np.testing.assert_allclose(squares, history.nis[1:], rtol=1e-9)
    # Sensor 4's noise is 1.22 times the configured.
    assert innovations["noise_scale"] == pytest.approx(1.22, abs=0.03)
    assert innovations["scaled_per_arc"] == pytest.approx(1.0, abs=0.02)
    assert 0.9 < innovations["within"] <= 1.0
    assert abs(innovations["lag_one"]) < 4.0 / np.sqrt(innovations["count"])
    assert described["availability"]["estimate"] > described["availability"]["baseline"]
    assert described["matched_stars"]["estimate"] == history.matched.sum()
    series = described["history"]
    assert series["frame_id"][-1] == history.frame_id[-1]
    assert series["parameters"]["f_m"]["value"][-1] == document["parameters"][0]["fitted"]
    assert found.provenance == PROVENANCE


@pytest.mark.parametrize(
    ("variant", "reason"),
    [
        (Variant(matches="telemetry"), "--no-rematch"),
        (Variant(method="smoother", precision="single"), "no single precision"),
        (Variant(method="smoother", process_noise={"f_m": 0.1}), "no process noise"),
        (Variant(parameters=("f_m", "zoom")), "zoom"),
        (Variant(parameters=("f_m", "f_m")), "once"),
        (Variant(temperature=("warmth",)), "warmth"),
    ],
)
def test_variants_that_make_no_sense_are_refused(variant, reason):
    with pytest.raises(UsageError, match=reason):
        fit(simulation(4, 54, 300), variant)


def test_a_calibration_of_another_sensor_is_bad_input():
    data = simulation(4, 54, 300)
    with pytest.raises(InputError, match="sensor ST16-9, not ST16-4"):
        fit(data, initial=replace(data.initial, sensor_id="ST16-9"))


def test_too_few_frames_are_refused():
    data = simulation(4, 54, 300)
    result = fit(data, frames=data.calibration.frames.take(np.arange(12)))
    assert result.calibration is None
    assert "frames identified" in " ".join(result.document["verdict"]["reasons"])
    # The state is there all the same, to go on from.
    assert result.states["constant"].last_frame_id == data.calibration.frames.frame_id[11]
