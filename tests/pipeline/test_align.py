"""The alignment stage on simulated telemetry, whose mounting is known."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import ROOT, simulation, st16_matcher
from scipy.spatial.transform import Rotation

from stcal.config import SensorConfig
from stcal.constants import ARCSEC
from stcal.errors import InputError
from stcal.geometry.rotations import vector_from_matrix
from stcal.matching import Matcher
from stcal.pipeline.align import AlignOptions, align
from stcal.pipeline.align_estimate import estimate_alignment
from stcal.pipeline.body_attitude import BodyAttitudes, attitudes_at, telemetered_attitudes
from stcal.pipeline.describe_align import euler_angles
from stcal.pipeline.pairing import first_exposures, pair, solved_attitudes
from stcal.simulate import load_scenario, scenario_with, simulate
from stcal.simulate.attitude import mounting_rotation
from stcal.simulate.timeline import attitudes as true_attitudes
from stcal.simulate.world import make_world

METHODS = ("linear", "multiplicative")
SECOND = 1_000_000_000


@pytest.fixture(scope="module")
def data():
    return simulation(4, 61, 160)


@pytest.fixture(scope="module")
def stars(data):
    return first_exposures([data.calibration.frames], data.true, st16_matcher())


def mounting(data):
    """The true c_sb."""
    return mounting_rotation(data.scenario.mounting).inv().as_matrix()


def record(data, sd=0.0, stated=0.0, seed=1):
    """The body's true attitude at the frames' times, turned by noise about the axes of B."""
    part, rng = data.calibration, np.random.default_rng(seed)
    c_ib = Rotation.from_quat(part.truth.q_si[::2]) * Rotation.from_matrix(mounting(data))
    q_bi = (c_ib * Rotation.from_rotvec(sd * rng.normal(size=(len(c_ib), 3)))).as_quat()
    covariance = np.tile(np.eye(3) * stated**2, (len(q_bi), 1, 1))
    return BodyAttitudes(part.frames.t_tai_ns, q_bi, covariance, {"file": "body.csv"})


def run(data, body, calibration=None, options=None, frames=None, matcher=None):
    return align(
        [data.calibration.frames if frames is None else frames],
        calibration or data.true,
        body,
        matcher or st16_matcher(),
        {"telemetry_sha256": "a" * 64},
        options or AlignOptions(),
    )


def errors(document, truth):
    """Errors in sd about the axes of S by method."""
    found = {}
    for name, method in document["methods"].items():
        turn = vector_from_matrix((np.array(method["c_sb"]) @ truth.T)[None])[0]
        found[name] = turn / ARCSEC / method["sd_arcsec"]
    return found


@pytest.mark.parametrize(("noise", "stated"), [(0.0, 0.0), (5e-5, 5e-5), (5e-5, 0.0)])
def test_the_mounting_is_recovered_within_its_sd(data, noise, stated):
    document = run(data, record(data, noise, stated))
    assert document["verdict"]["accepted"], document["verdict"]
    for name, error in errors(document, mounting(data)).items():
        assert (np.abs(error) < 4.0).all(), name
    # Nothing much is left, and the two agree.
    assert max(document["methods"]["multiplicative"]["sd_arcsec"]) < 8.0
    apart = np.array(document["methods"]["linear"]["from_multiplicative_arcsec"])
    assert (np.abs(apart) < 3.0 * np.array(document["methods"]["linear"]["sd_arcsec"])).all()


@pytest.mark.parametrize(("noise", "low", "high"), [(0.0, 0.8, 1.1), (5e-5, 0.85, 1.15)])
def test_errors_over_many_attitude_records_are_those_of_the_covariance(
    data, stars, noise, low, high
):
    """Star noise redrawn about the true directions, as the configuration states it."""
    rng, truth = np.random.default_rng(3), mounting(data)
    exact = record(data)
    c_bi, _ = attitudes_at(exact, stars.t_tai_ns, 1.0)
    s_s = np.einsum("kij,kj->ki", c_bi[stars.frame], stars.s_i) @ truth.T
    ratio = {name: [] for name in METHODS}
    for seed in range(50):
        noisy = s_s + np.cross(s_s, rng.normal(size=s_s.shape)) * stars.sd[:, None]
        noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
        paired = pair(replace(stars, s_s=noisy), record(data, noise, noise, seed), 1.0, 0.0)
        for name, found in estimate_alignment(paired.sightings, 5.0).methods.items():
            turn = vector_from_matrix((found.c_sb[-1] @ truth.T)[None])[0]
            ratio[name].append(turn / np.sqrt(np.diag(found.covariance[-1])))
    for name in METHODS:
        assert low < np.sqrt(np.mean(np.square(ratio[name]))) < high, name


def test_noise_that_is_not_stated_is_found_and_raises_the_sd(data):
    stated = run(data, record(data, 5e-5, 5e-5))
    silent = run(data, record(data, 5e-5))
    assert stated["noise"]["attitude_excess_urad"] < 25.0
    assert silent["noise"]["attitude_excess_urad"] == pytest.approx(50.0, rel=0.25)
    assert "state the noise" in silent["verdict"]["notes"][-1]
    assert not stated["verdict"]["notes"]
    sd = [d["methods"]["multiplicative"]["sd_arcsec"] for d in (silent, stated)]
    np.testing.assert_allclose(sd[0][:2], sd[1][:2], rtol=0.35)
    assert silent["nis"]["mean"] > 3.0 * stated["nis"]["mean"]
    told = run(data, record(data, 5e-5), options=AlignOptions(attitude_sd_urad=50.0))
    np.testing.assert_allclose(told["result"]["c_sb"], stated["result"]["c_sb"], atol=1e-12)
    np.testing.assert_allclose(told["result"]["sd_arcsec"], stated["result"]["sd_arcsec"])


def test_the_document_is_whole_and_consistent(data):
    document = run(data, record(data, 3e-5, 3e-5))
    frames = data.calibration.frames.n_frames
    assert document["schema"] == "stcal.alignment/1"
    assert document["result"] == document["methods"]["multiplicative"]
    linear = run(data, record(data, 3e-5, 3e-5), options=AlignOptions(method="linear"))
    assert linear["result"] == document["methods"]["linear"]
    assert document["frames"] == frames >= document["frames_identified"]
    assert document["frames_used"] + document["frames_rejected"] == document["frames_with_attitude"]
    assert document["stars_used"] > 8 * document["frames_used"]
    assert 60.0 < document["rms_residual_urad"] < 150.0
    nis = document["nis"]
    spread = 1.96 * np.sqrt(6.0 / document["frames_used"])
    np.testing.assert_allclose(nis["interval"], [3.0 - spread, 3.0 + spread], atol=0.06)
    c_sb = np.array(document["result"]["c_sb"])
    np.testing.assert_allclose(c_sb @ c_sb.T, np.eye(3), atol=1e-12)
    v_s = c_sb @ [0.1, 0.2, 0.3]
    np.testing.assert_allclose(
        Rotation.from_quat(document["result"]["q_sb"]).apply(v_s), [0.1, 0.2, 0.3], atol=1e-12
    )
    angles = document["result"]["angles_deg"]
    turned = Rotation.from_euler("ZYX", [angles[k] for k in ("yaw", "pitch", "roll")], degrees=True)
    np.testing.assert_allclose(turned.as_matrix().T, c_sb, atol=1e-12)
    sd = np.sqrt(np.diag(document["result"]["covariance_rad2"])) / ARCSEC
    np.testing.assert_allclose(sd, document["result"]["sd_arcsec"])


def test_the_history_ends_in_the_result_and_narrows(data):
    history = run(data, record(data, 3e-5, 3e-5))["history"]
    assert history["frames"][0] == 2
    assert history["elapsed_s"][0] > 0.0
    assert len(history["frames"]) == len(history["time_utc"]) <= 100
    for name in METHODS:
        departure, sd = (np.array(history[name][k]) for k in ("departure_arcsec", "sd_arcsec"))
        np.testing.assert_allclose(departure[-1], 0.0, atol=1e-6)
        assert (sd[-1] < 0.3 * sd[1]).all()
        # A part of the data against all of it: the difference has less than the part's variance.
        assert (np.abs(departure) < 4.5 * sd).all()


def test_the_papers_matrix_is_one_degree_about_each_axis():
    paper = np.array([[0.999695, 0.017449, -0.017452], [-0.017145, 0.999700, 0.017449],
                      [0.017751, -0.017145, 0.999695]])  # fmt: skip
    np.testing.assert_allclose(np.degrees(euler_angles(paper)), 1.0, atol=2e-4)


def test_attitudes_between_the_samples_are_interpolated(data):
    """A record every 4 s, none of it at a frame's time."""
    scenario = data.scenario
    world = make_world(scenario, "calibration", data.seed)
    sampled = [
        true_attitudes(world.timeline, world.orbit, slice(None), delay)[0] for delay in (-1.0, 3.0)
    ]
    t = data.calibration.frames.t_tai_ns
    order = np.argsort(np.concatenate([t - SECOND, t + 3 * SECOND]))
    times = np.concatenate([t - SECOND, t + 3 * SECOND])[order]
    body = BodyAttitudes(
        times, np.concatenate(sampled)[order], np.zeros((len(times), 3, 3)), {"file": "b"}
    )
    c_bi, covariance = attitudes_at(body, t, 4.0)
    exact, _ = attitudes_at(record(data), t, 4.0)
    apart = vector_from_matrix(c_bi @ np.swapaxes(exact, 1, 2))
    assert np.abs(apart).max() < 1e-6
    assert np.isfinite(covariance).all()
    assert run(data, body, options=AlignOptions(maximum_gap_s=3.9))["frames_with_attitude"] == 0
    document = run(data, body)
    assert document["verdict"]["accepted"]
    assert (np.abs(errors(document, mounting(data))["multiplicative"]) < 4.0).all()


def test_which_times_have_an_attitude():
    turn = Rotation.from_rotvec(np.outer([0.0, 1.0, 2.0, 3.0], [0.0, 0.0, 0.1])).as_quat()
    noise = np.eye(3) * np.array([1.0, 4.0, 9.0, 16.0])[:, None, None]
    body = BodyAttitudes(np.array([0, 10, 20, 40]) * SECOND, turn, noise, {})
    t = np.array([-1, 0, 4, 10, 20, 25, 40, 41]) * SECOND
    c_bi, covariance = attitudes_at(body, t, 10.0)
    assert np.isfinite(c_bi[:, 0, 0]).tolist() == [False, True, True, True, True, False, True,
                                                  False]  # fmt: skip
    # q gives v_B -> v_I, so c_bi turns the other way.
    np.testing.assert_allclose(vector_from_matrix(c_bi[2:3])[0], [0, 0, -0.04], atol=1e-12)
    np.testing.assert_allclose(covariance[[1, 2, 3, 6], 0, 0], [1.0, 2.2, 4.0, 16.0])
    empty = BodyAttitudes(np.empty(0, np.int64), np.empty((0, 4)), np.empty((0, 3, 3)), {})
    assert np.isnan(attitudes_at(empty, t, 10.0)[0]).all()


def test_wrong_attitudes_are_left_out(data):
    clean = record(data, 3e-5, 3e-5)
    wrong = np.arange(0, len(clean.q_bi), 8)
    size = np.where(np.arange(len(wrong)) % 2, 2.0, 0.003)
    turn = Rotation.from_rotvec(size[:, None] * np.array([0.6, 0.8, 0.0]))
    q_bi = clean.q_bi.copy()
    q_bi[wrong] = (Rotation.from_quat(q_bi[wrong]) * turn).as_quat()
    document, expected = run(data, replace(clean, q_bi=q_bi)), run(data, clean)
    assert document["verdict"]["accepted"], document["verdict"]
    identified = len(wrong) * expected["frames_used"] / data.calibration.frames.n_frames
    assert document["frames_rejected"] == pytest.approx(identified, abs=3)
    assert document["history"]["time_utc"][-1] == document["span"]["to"]
    for name in METHODS:
        both = [np.array(d["methods"][name]["c_sb"]) for d in (document, expected)]
        apart = vector_from_matrix((both[0] @ both[1].T)[None])[0] / ARCSEC
        assert (np.abs(apart) < expected["methods"][name]["sd_arcsec"]).all()


def test_a_frame_is_judged_by_its_own_noise(data, stars):
    """Off by 800 urad: nothing for most of the record, but 30 sd for its few exact attitudes."""
    exact = np.arange(len(data.calibration.frames.t_tai_ns)) % 4 == 0
    noisy = record(data, 5e-4, 5e-4)
    q_bi = np.where(exact[:, None], record(data).q_bi, noisy.q_bi)
    wrong = np.flatnonzero(exact)[3:30:6]
    turn = Rotation.from_rotvec([8e-4, 0.0, 0.0])
    q_bi[wrong] = (Rotation.from_quat(q_bi[wrong]) * turn).as_quat()
    body = replace(noisy, q_bi=q_bi, covariance=noisy.covariance * ~exact[:, None, None])
    paired = pair(stars, body, 10.0, 0.0)
    kept = estimate_alignment(paired.sightings, 5.0).kept
    left_out = paired.t_tai_ns[~kept]
    assert np.array_equal(left_out, np.intersect1d(paired.t_tai_ns, body.t_tai_ns[wrong]))
    assert len(left_out) >= 3


def test_frames_that_contradict_each_other_are_refused(data):
    body = record(data)
    third = np.arange(len(body.q_bi)) % 3 == 0
    turned = Rotation.from_quat(body.q_bi[third]) * Rotation.from_rotvec([0.02, 0.0, 0.0])
    q_bi = body.q_bi.copy()
    q_bi[third] = turned.as_quat()
    document = run(data, replace(body, q_bi=q_bi))
    assert document["result"] is None
    assert "contradict the others" in document["verdict"]["reasons"][0]


def test_an_uncalibrated_camera_is_refused(data):
    document = run(data, record(data), calibration=data.initial)
    assert document["result"] is None
    assert "the calibration is not good" in document["verdict"]["reasons"][-1]
    assert document["methods"]["multiplicative"]["c_sb"]


def test_stars_beyond_their_noise_are_refused(data):
    config = st16_matcher().config
    quiet = config.model_copy(update={"noise": config.noise.model_copy(update={"sd_px": 0.05})})
    document = run(data, record(data), matcher=Matcher(st16_matcher().catalogue, quiet))
    assert any("within their own frames" in reason for reason in document["verdict"]["reasons"])
    assert document["noise"]["stars"] == pytest.approx(0.49 / 0.05, rel=0.1)


def test_the_frame_s_is_that_of_the_calibration(data):
    turn = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
    plain = run(data, record(data))
    turned = run(data, record(data), calibration=replace(data.true, c_sd=turn @ data.true.c_sd))
    np.testing.assert_allclose(turned["result"]["c_sb"], turn @ plain["result"]["c_sb"], atol=1e-11)


def test_too_few_frames_time_or_attitudes_are_refused(data):
    body = record(data)
    frames = data.calibration.frames
    few = run(data, body, frames=frames.take(np.arange(12)))
    assert few["result"] is None
    assert few["methods"] == {}
    assert "at least 30 needed" in few["verdict"]["reasons"][0]
    third = slice(0, None, 3)
    sparse = BodyAttitudes(
        body.t_tai_ns[third], body.q_bi[third], body.covariance[third], body.source
    )
    document = run(data, sparse)
    assert "50% needed" in document["verdict"]["reasons"][0]
    assert document["frames_with_attitude"] < 0.4 * document["frames_identified"]
    other = replace(body, t_tai_ns=body.t_tai_ns + 10**15)
    assert run(data, other)["frames_with_attitude"] == 0


def test_a_short_span_is_refused(data):
    frames = data.calibration.frames
    start = frames.t_tai_ns[0]
    quick = start + (frames.t_tai_ns - start) // 1000
    body = replace(record(data), t_tai_ns=quick)
    document = run(data, body, frames=replace(frames, t_tai_ns=quick))
    assert any("at least 200 s needed" in reason for reason in document["verdict"]["reasons"])


def test_a_calibration_of_another_sensor_is_bad_input(data):
    with pytest.raises(InputError, match="sensor ST16-5, not ST16-4"):
        run(data, record(data), calibration=replace(data.true, sensor_id="ST16-5"))


def test_only_exposure_0_is_used(data, stars):
    """Exposure 1 is later, and the body turns: 0.1 s at 0.06 deg/s are 105 urad."""
    frames = data.calibration.frames
    spoilt = frames.exposure_of_star % 2 == 1
    row = np.where(spoilt, frames.row_px[::-1], frames.row_px)
    again = first_exposures([replace(frames, row_px=row)], data.true, st16_matcher())
    assert np.array_equal(stars.s_s, again.s_s)
    assert np.array_equal(stars.t_tai_ns, again.t_tai_ns)


def test_parts_give_the_same_as_the_whole(data, stars):
    frames = data.calibration.frames
    cuts = [np.arange(0, 50), np.arange(50, 60), np.arange(60, frames.n_frames)]
    split = first_exposures([frames.take(c) for c in cuts], data.true, st16_matcher())
    for name in ("s_s", "s_i", "sd", "frame", "t_tai_ns"):
        assert np.array_equal(getattr(split, name), getattr(stars, name)), name


def test_gross_centroids_are_left_out(data, stars):
    """Centroids off by 3 px stay within the matching tolerance."""
    frames = data.calibration.frames
    hit = np.zeros(frames.n_stars, dtype=bool)
    hit[5::97] = True
    row = frames.row_px + np.where(hit, 2.9, 0.0)
    found = first_exposures([replace(frames, row_px=row)], data.true, st16_matcher())
    assert found.rejected > stars.rejected + 5


@pytest.fixture(scope="module")
def pair_of_sensors():
    """Sensors 3 and 4 on one satellite that points without wander."""
    folder = ROOT / "configs" / "scenarios"
    change = {"calibration__segments__0__wander_deg": 0.0, "calibration__segments__0__frames": 110,
              "validation__segments__0__frames": 20}  # fmt: skip
    return tuple(
        simulate(scenario_with(load_scenario(folder / f"st16-{n}.toml"), **change), 7)
        for n in (3, 4)
    )


def test_another_sensor_serves_as_the_body(pair_of_sensors):
    three, four = pair_of_sensors
    body = solved_attitudes(
        first_exposures([three.calibration.frames], three.true, st16_matcher()),
        {"sensor": "ST16-3"},
    )
    document = run(four, body)
    assert document["verdict"]["accepted"], document["verdict"]
    truth = mounting(four) @ mounting(three).T
    for name, error in errors(document, truth).items():
        assert (np.abs(error) < 4.0).all(), name
    # The other's roll noise is stated with its attitudes, so that the NIS holds.
    assert document["nis"]["mean"] < 6.0
    blind = run(four, replace(body, covariance=0.0 * body.covariance))
    assert not blind["verdict"]["accepted"] or blind["nis"]["mean"] > 3.0 * document["nis"]["mean"]


def test_telemetered_attitudes_are_those_of_exposure_0(pair_of_sensors):
    three, _ = pair_of_sensors
    frames = three.calibration.frames
    body = telemetered_attitudes([frames.take(np.arange(40)), frames.take(np.arange(40, 110))], {})
    chosen = frames.best_exposure == 0
    assert 0.3 < chosen.mean() < 0.9
    assert np.array_equal(body.t_tai_ns, frames.t_tai_ns[chosen])
    error = Rotation.from_quat(body.q_bi).inv() * Rotation.from_quat(
        three.calibration.truth.q_si[::2][chosen]
    )
    assert np.median(error.magnitude()) < 0.05


def test_the_gates_follow_the_configuration(data):
    config = st16_matcher().config
    loose = config.model_copy(update={"fit": config.fit.model_copy(update={"minimum_frames": 5})})
    assert isinstance(loose, SensorConfig)
    document = run(
        data, record(data), frames=data.calibration.frames.take(np.arange(12)),
        matcher=Matcher(st16_matcher().catalogue, loose),
    )  # fmt: skip
    assert document["verdict"]["accepted"], document["verdict"]
