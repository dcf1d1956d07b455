"""Simulated telemetry against its own truth, statistics, and reproducibility."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stcal.catalog.apparent import apparent_directions, observer_at
from stcal.config import SensorConfig
from stcal.constants import DEG, SPEED_OF_LIGHT_M_S
from stcal.errors import ConfigError
from stcal.frames import FrameBatch, concatenate
from stcal.simulate import load_scenario, scenario_with, simulate, stream
from stcal.simulate.attitude import attitude_at
from stcal.simulate.world import CHUNK_FRAMES, make_world

FOLDER = Path(__file__).parents[2] / "configs" / "scenarios"
FRAMES = 2 * CHUNK_FRAMES + 40


@pytest.fixture(scope="module")
def base():
    return scenario_with(
        load_scenario(FOLDER / "st16-1.toml"),
        calibration__segments__0__frames=FRAMES,
        validation__segments__0__frames=20,
        visibility__keep_flagged=0.05,
    )


@pytest.fixture(scope="module")
def simulation(base):
    return simulate(base, 11)


def _true_places(simulation, frames, truth, with_velocity=True):
    """Return (detections (K,), apparent s_i (K, 3), exposure (K,)) from identifiers alone."""
    sky = make_world(simulation.scenario, "calibration", 0).sky.catalogue
    order = np.argsort(sky.star_id)
    real = np.flatnonzero(truth.star_id > 0)
    star = order[np.searchsorted(sky.star_id, truth.star_id[real], sorter=order)]
    velocity = truth.vel_km_s if with_velocity else np.full_like(truth.vel_km_s, np.nan)
    exposure = frames.exposure_of_star[real]
    observer = observer_at(frames.t_tai_ns, truth.pos_km, velocity)
    return real, apparent_directions(sky, star, exposure // 2, observer), exposure


def _centroid_errors(simulation, with_velocity=True):
    """Return (K, 2) px from the true camera's images of the apparent places, and detections."""
    frames, truth = simulation.calibration.frames, simulation.calibration.truth
    real, s_i, exposure = _true_places(simulation, frames, truth, with_velocity)
    s_s = Rotation.from_quat(truth.q_si[exposure]).inv().apply(s_i)
    m, n = simulation.true.camera.project(s_s @ simulation.true.c_sd)
    error = np.stack([frames.row_px[real] - m, frames.col_px[real] - n], axis=1)
    return error, real


def test_centroids_lead_back_to_the_sky_within_their_noise(simulation):
    error, real = _centroid_errors(simulation)
    truth = simulation.calibration.truth
    clean = ~truth.outlier[real]
    scaled = error[clean] / truth.sd_px[real][clean, None]
    # rms^2 of 2 K unit normals has a sd of sqrt(1 / K); rounding and edge losses are far below.
    assert np.mean(scaled**2) == pytest.approx(1.0, abs=3 / np.sqrt(len(scaled)))
    assert np.abs(scaled.mean(axis=0)).max() < 3.5 / np.sqrt(len(scaled))
    assert np.abs(scaled).max() < 6.0
    assert len(scaled) > 8000


def test_photon_noise_grows_for_faint_stars(base):
    scenario = scenario_with(
        base, noise__photon_sd_px=0.5, noise__sd_px=0.1, noise__reference_intensity=2000.0
    )
    simulation = simulate(scenario, 3)
    error, real = _centroid_errors(simulation)
    part = simulation.calibration
    clean = ~part.truth.outlier[real]
    counts = part.frames.intensity[real][clean]
    sd = np.sqrt(0.1**2 + 0.5**2 * 2000.0 / counts)
    for half in (counts < np.median(counts), counts >= np.median(counts)):
        scaled = error[clean][half] / sd[half, None]
        assert np.mean(scaled**2) == pytest.approx(1.0, abs=3.5 / np.sqrt(half.sum()))


@pytest.mark.parametrize("telemetered", [True, False])
def test_the_sky_moves_with_the_spacecraft(base, telemetered):
    scenario = scenario_with(
        base,
        noise__sd_px=0.0,
        detection__outlier_probability=0.0,
        telemetry__spacecraft_state=telemetered,
    )
    simulation = simulate(scenario, 3)
    with_it, _ = _centroid_errors(simulation)
    without, _ = _centroid_errors(simulation, with_velocity=False)
    # What remains is the telemetry's rounding to 1e-3 px.
    assert np.abs(with_it).max() < 0.001
    frames = simulation.calibration.frames
    assert np.isfinite(frames.pos_km).all() == telemetered
    assert np.isfinite(frames.vel_km_s).all() == telemetered
    # Without it: v / c across the line of sight, up to 25 urad, 0.18 px.
    speed = np.linalg.norm(simulation.calibration.truth.vel_km_s, axis=1).mean() * 1e3
    bulk = np.median(np.hypot(*without.T))
    pixel = scenario.sensor.detector.pixel_size_m / 0.016
    assert 0.3 < bulk * pixel / (speed / SPEED_OF_LIGHT_M_S) < 1.05


def test_missing_false_and_gross_centroids_at_their_rates(base):
    scenario = scenario_with(
        base,
        detection__missing_probability=0.2,
        detection__false_stars_per_exposure=1.5,
        detection__outlier_probability=0.03,
        detection__outlier_sd_px=40.0,
        detection__maximum_stars=1000,
    )
    part, full = simulate(scenario, 5).calibration, simulate(base, 5).calibration
    exposures = part.frames.n_exposures
    false = np.bincount(part.frames.exposure_of_star[part.truth.star_id == 0], minlength=exposures)
    assert false.mean() == pytest.approx(1.5, abs=4 * np.sqrt(1.5 / exposures))
    assert false.var() == pytest.approx(1.5, rel=0.2)
    where = part.truth.star_id == 0
    for px, size in ((part.frames.row_px, 1944), (part.frames.col_px, 2592)):
        assert px[where].mean() == pytest.approx(size / 2, abs=4 * size / np.sqrt(12 * where.sum()))
        assert px[where].std() == pytest.approx(size / np.sqrt(12), rel=0.06)
    real = ~where
    count = real.sum()
    assert part.truth.outlier[real].mean() == pytest.approx(0.03, abs=4 * np.sqrt(0.03 / count))
    error, index = _centroid_errors(simulate(scenario, 5))
    gross = part.truth.outlier[index]
    assert error[gross].std() == pytest.approx(40.0, rel=0.15)
    # Missing at random: the share of 0.02 in the base scenario became 0.2.
    ratio = count / (full.truth.star_id != 0).sum()
    assert ratio == pytest.approx(0.8 / 0.98, abs=0.02)


def test_detection_probability_halves_at_the_limit(base):
    scenario = scenario_with(base, detection__width_mag=0.3, detection__missing_probability=0.0)
    part = simulate(scenario, 6).calibration
    sky = make_world(scenario, "calibration", 0).sky.catalogue
    order = np.argsort(sky.star_id)
    star = order[np.searchsorted(sky.star_id, part.truth.star_id, sorter=order)]
    star, exposure = star[part.truth.star_id > 0], part.frames.exposure_of_star
    seen = np.zeros((part.frames.n_exposures, sky.n_stars), dtype=bool)
    seen[exposure[part.truth.star_id > 0], star] = True
    # A star seen in one exposure is in the field of the other one 0.1 s later.
    first, second = seen[0::2], seen[1::2]
    for low, high, limit in ((4.9, 5.1, 5.0), (4.0, 4.3, 5.0), (5.2, 5.4, 5.0)):
        band = (sky.magnitude > low) & (sky.magnitude < high)
        share = (first & second)[:, band].sum() / first[:, band].sum()
        expected = 1 / (1 + np.exp((0.5 * (low + high) - limit) / 0.3))
        assert share == pytest.approx(expected, abs=0.06)


def test_intensity_follows_magnitude_and_the_brightest_are_kept(base):
    scenario = scenario_with(
        base, detection__maximum_stars=6, detection__limiting_magnitude=5.5,
        intensity__scatter_mag=0.0, detection__false_stars_per_exposure=0.0,
    )  # fmt: skip
    part = simulate(scenario, 7).calibration
    sky = make_world(scenario, "calibration", 0).sky.catalogue
    magnitude = dict(zip(sky.star_id.tolist(), sky.magnitude.tolist(), strict=True))
    expected = [10 ** (0.4 * (13.0 - magnitude[code])) for code in part.truth.star_id.tolist()]
    np.testing.assert_allclose(part.frames.intensity, expected, atol=0.06)
    assert part.frames.stars_per_exposure.max() == 6
    same = np.diff(part.frames.exposure_of_star) == 0
    assert (np.diff(part.frames.intensity)[same] <= 0).all()


def test_onboard_solution_and_rates(simulation):
    frames, truth = simulation.calibration.frames, simulation.calibration.truth
    fix = frames.has_fix
    assert 0.6 < fix.mean() < 1.0
    np.testing.assert_array_equal(fix, frames.best_exposure >= 0)
    np.testing.assert_array_equal(fix, np.isfinite(frames.rate_deg_s).all(axis=1))
    exposure = 2 * np.flatnonzero(fix) + frames.best_exposure[fix]
    solved, true = Rotation.from_quat(frames.q_si[fix]), Rotation.from_quat(truth.q_si[exposure])
    # The initial calibration is wrong: the attitude is off by that, not by more.
    assert (true.inv() * solved).magnitude().max() < 0.02
    rate = (frames.rate_deg_s - truth.rate_deg_s)[fix]
    np.testing.assert_allclose(rate.std(axis=0), 0.02, rtol=0.15)
    identified = frames.star_id > 0
    wrong = identified & (frames.star_id != truth.star_id)
    assert wrong.sum() <= identified.sum() / 200
    assert identified.sum() > 3000


def test_true_rates_are_those_of_the_true_attitudes(simulation):
    truth = simulation.calibration.truth
    q = Rotation.from_quat(truth.q_si)
    separation = simulation.scenario.telemetry.exposure_separation_s
    difference = (q[0::2].inv() * q[1::2]).as_rotvec() / separation / DEG
    np.testing.assert_allclose(truth.rate_deg_s, difference, atol=1e-5)
    assert np.linalg.norm(truth.rate_deg_s, axis=1).min() > 0.05  # one turn an orbit


def _assert_equal(a, b):
    for name in (f.name for f in fields(a)):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


def test_same_seed_gives_the_same_and_chunks_stand_alone(base, simulation):
    _assert_equal(simulation.calibration.frames, simulate(base, 11).calibration.frames)
    chunks = [part.frames for part in stream(base, "calibration", 11)]
    assert [c.n_frames for c in chunks] == [CHUNK_FRAMES, CHUNK_FRAMES, FRAMES - 2 * CHUNK_FRAMES]
    _assert_equal(simulation.calibration.frames, concatenate(chunks))
    with ThreadPoolExecutor(2) as pool:

        def backwards(function, items):
            listed = list(items)[::-1]
            return list(pool.map(function, listed))[::-1]

        other = simulate(base, 11, backwards)
    _assert_equal(simulation.calibration.frames, other.calibration.frames)
    _assert_equal(simulation.calibration.truth, other.calibration.truth)


def test_seeds_parts_and_sensors_differ(base, simulation):
    assert not np.array_equal(
        simulate(base, 12).calibration.frames.row_px[:50],
        simulation.calibration.frames.row_px[:50],
    )
    renamed = simulate(scenario_with(base, sensor_id="ST16-99"), 11)
    assert renamed.calibration.frames.n_stars != simulation.calibration.frames.n_stars
    ids = [simulation.calibration.frames.frame_id, simulation.validation.frames.frame_id]
    assert (np.diff(np.concatenate(ids)) > 0).all()
    times = [simulation.calibration.frames.t_tai_ns, simulation.validation.frames.t_tai_ns]
    assert (np.diff(np.concatenate(times)) > 0).all()
    assert (np.concatenate(times) % 1_000_000 == 0).all()


def test_flagged_frames_are_a_small_share_and_lose_faint_stars(base):
    scenario = scenario_with(
        base, visibility__sun_exclusion_deg=100.0, visibility__keep_flagged=0.3
    )
    frames = simulate(scenario, 8).calibration.frames
    assert frames.n_frames == FRAMES
    flagged = frames.intrusion | frames.eclipse
    assert 0.05 < flagged.mean() < 0.6
    stars = frames.stars_per_exposure.reshape(-1, 2).sum(axis=1)
    assert stars[frames.intrusion].mean() < 0.5 * stars[~flagged].mean()
    none = simulate(scenario_with(scenario, visibility__keep_flagged=0.0), 8).calibration.frames
    assert not (none.intrusion | none.eclipse).any()


def test_a_sensor_that_never_sees_the_sky_is_refused(base):
    with pytest.raises(ConfigError, match=r"segment 0 \(nadir-pointing\) finds 0 of 20 frames"):
        simulate(
            scenario_with(
                base, mounting__boresight_b=(0.0, 0.0, 1.0), calibration__segments__0__frames=20,
                visibility__keep_flagged=0.0,
            ),
            1,
        )  # fmt: skip


def test_another_camera_by_configuration_alone(base):
    document = base.sensor.model_dump(by_alias=True)
    document |= {"name": "Other", "sensor_ids": ["OTHER-*"]}
    document["detector"] |= {"rows": 1024, "cols": 1280, "pixel_size_m": 5.3e-6}
    scale = document["camera"]["scale"]
    scale["f_m"]["nominal"], scale["m0_px"]["nominal"], scale["n0_px"]["nominal"] = 0.02, 512, 640
    config = SensorConfig.model_validate(document)
    scenario = scenario_with(base, sensor=config, sensor_id="OTHER-7", camera__offset_sigma={})
    part = simulate(scenario, 2).calibration
    assert isinstance(part.frames, FrameBatch)
    assert part.frames.row_px.max() > 1000
    assert part.frames.row_px.max() <= 1023.5
    assert part.frames.has_fix.mean() > 0.9
    error, real = _centroid_errors(simulate(scenario, 2))
    assert np.median(np.abs(error[~part.truth.outlier[real]])) < 1.0


def test_shifted_alignment_is_in_the_true_attitude(base):
    shift = (300.0, -200.0, 100.0)
    simulation = simulate(scenario_with(base, mounting__c_sd_shift_urad=shift), 11)
    turn = Rotation.from_matrix(simulation.true.c_sd @ simulation.initial.c_sd.T).as_rotvec()
    np.testing.assert_allclose(turn * 1e6, shift, atol=1e-6)
    error, real = _centroid_errors(simulation)
    clean = ~simulation.calibration.truth.outlier[real]
    assert error[clean].std() == pytest.approx(0.41, rel=0.03)


def test_chunks_have_their_own_noise(base):
    # The same scene in both chunks: one stream of random numbers would repeat the telemetry.
    hold = {"motion": "coarse-hold", "frames": 2 * CHUNK_FRAMES, "target_deg": (60.0, 20.0, 15.0)}
    scenario = scenario_with(
        base,
        calibration__segments=[hold],
        visibility__keep_flagged=1.0,
        visibility__intrusion_loss_mag=0.0,
    )
    frames = simulate(scenario, 9).calibration.frames
    first, second = (frames.take(np.arange(k, k + 50)) for k in (0, CHUNK_FRAMES))
    assert not np.array_equal(first.star_offsets, second.star_offsets)


def test_consecutive_segments_join_without_a_jump():
    scenario = load_scenario(FOLDER / "st16-6.toml")
    world = make_world(scenario, "calibration", 4)
    hold, slew = world.timeline.motions
    start = np.array([slew.start_s])
    assert world.timeline.t_s[world.timeline.motion == 1][0] >= start[0]
    ends, begins = (attitude_at(motion, world.orbit, start)[0] for motion in (hold, slew))
    assert (ends.inv() * begins).magnitude()[0] < 1e-12
    later = attitude_at(hold, world.orbit, start + 100.0)[0]
    assert (ends.inv() * later).magnitude()[0] > 1e-3  # it does wander
