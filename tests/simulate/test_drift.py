"""Cameras that drift: with the temperature, with age, and in steps."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stcal.catalog.apparent import apparent_directions, observer_at
from stcal.errors import ConfigError
from stcal.simulate import load_scenario, scenario_with, simulate
from stcal.simulate.files import write_simulation
from stcal.simulate.orbit import orbit_from
from stcal.simulate.true_camera import field_of_view
from stcal.simulate.world import make_world

FOLDER = Path(__file__).parents[2] / "configs" / "scenarios"
FRAMES = 300
F, M0, GY = 0, 1, 7
SIGMA = np.array([8e-6, 30.0, 30.0, 1e8, 1e3, 0.01, 0.01, 2e-4])


def _short(name, **changes):
    parts = {"calibration__segments__0__frames": FRAMES, "validation__segments__0__frames": 20}
    return scenario_with(load_scenario(FOLDER / name), **(parts | changes))


@pytest.fixture(scope="module")
def scenario():
    return _short("st16-drift.toml")


def _offsets(simulation, part="calibration"):
    """(F, P) departures from the camera at the epoch, in sigma, and the frames' times."""
    made = getattr(simulation, part)
    offset = made.truth.parameters - simulation.true.camera.parameters
    epoch = simulation.scenario.epoch_tai_ns
    return offset / SIGMA, (made.frames.t_tai_ns - epoch) * 1e-9


def test_parameters_follow_the_true_temperature(scenario):
    simulation = simulate(scenario, 1)
    offset, t_s = _offsets(simulation)
    period = orbit_from(scenario.orbit, scenario.epoch_tai_ns).nodal_period_s
    warmth = 8.0 * np.sin(2 * np.pi * t_s / period)
    np.testing.assert_allclose(offset[:, F], 0.25 * warmth, rtol=0, atol=1e-9)
    assert np.ptp(offset[:, F]) > 3.9
    assert not offset[:, 1:].any()
    temperature = simulation.calibration.frames.temperature_c
    np.testing.assert_allclose(temperature, 20.0 + warmth, rtol=0, atol=0.00501)


def test_noise_of_the_thermometer_is_not_that_of_the_camera(scenario):
    noisy = simulate(_short("st16-drift.toml", telemetry__temperature_sd_c=0.3), 1)
    clean = simulate(scenario, 1)
    error = noisy.calibration.frames.temperature_c - clean.calibration.frames.temperature_c
    assert error.std() == pytest.approx(0.3, rel=4 / np.sqrt(2 * FRAMES))
    np.testing.assert_array_equal(
        noisy.calibration.truth.parameters, clean.calibration.truth.parameters
    )
    np.testing.assert_array_equal(noisy.calibration.frames.row_px, clean.calibration.frames.row_px)


@pytest.mark.parametrize("name", ["st16-drift.toml", "st16-step.toml"])
def test_centroids_are_images_of_each_frames_own_camera(name):
    """Both exposures: star places from identifiers, one camera a star, without noise."""
    # Between the exposures of a frame: both are still made with the camera before.
    step = {"camera__drift__steps__0__at_s": 1500.05} if "step" in name else {}
    quiet = _short(
        name, noise__sd_px=0.0, detection__outlier_probability=0.0,
        detection__false_stars_per_exposure=0.0, **step,
    )  # fmt: skip
    simulation = simulate(quiet, 2)
    frames, truth = simulation.calibration.frames, simulation.calibration.truth
    sky = make_world(quiet, "calibration", 2).sky.catalogue
    order = np.argsort(sky.star_id)
    star = order[np.searchsorted(sky.star_id, truth.star_id, sorter=order)]
    exposure = frames.exposure_of_star
    observer = observer_at(frames.t_tai_ns, truth.pos_km, truth.vel_km_s)
    s_i = apparent_directions(sky, star, exposure // 2, observer)
    s_d = Rotation.from_quat(truth.q_si[exposure]).inv().apply(s_i) @ simulation.true.c_sd
    measured = np.stack([frames.row_px, frames.col_px])

    own = simulation.true.camera.with_parameters(truth.parameters[exposure // 2].T)
    # Telemetry rounds to 1e-3 px, and the observer is that of exposure 0.
    np.testing.assert_allclose(own.project(s_d), measured, rtol=0, atol=0.00055)
    fixed = np.array(simulation.true.camera.project(s_d))
    assert np.abs(fixed - measured).max() > 1.0


def test_a_step_comes_at_its_frame_and_stays(scenario):
    _, t_s = _offsets(simulate(scenario, 1))
    at = FRAMES - 20  # in the second chunk
    steps = [
        {"at_s": float(t_s[at]), "offset_sigma": {"f_m": 2.0, "g_y": -1.0}},
        {"at_s": float(t_s[at + 5]) - 0.001, "offset_sigma": {"f_m": 1.0}},
    ]
    simulation = simulate(_short("st16-drift.toml", camera__drift={"steps": steps}), 1)
    offset, _ = _offsets(simulation)
    expected = np.where(np.arange(FRAMES) < at, 0.0, 2.0)
    expected[at + 5 :] += 1.0
    np.testing.assert_allclose(offset[:, F], expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(offset[:, GY], np.where(expected > 0, -1.0, 0.0), rtol=0, atol=1e-9)
    later, _ = _offsets(simulation, "validation")
    np.testing.assert_allclose(later[:, F], 3.0, rtol=0, atol=1e-9)


def test_ageing_counts_from_the_epoch_and_adds_to_the_rest(scenario):
    drift = {"per_day": {"m0_px": 0.2}, "per_kelvin": {"f_m": 0.25, "m0_px": 0.1}}
    simulation = simulate(_short("st16-drift.toml", camera__drift=drift), 1)
    for part in ("calibration", "validation"):
        offset, t_s = _offsets(simulation, part)
        ageing = offset[:, M0] - 0.1 / 0.25 * offset[:, F]
        np.testing.assert_allclose(ageing, 0.2 * t_s / 86_400.0, rtol=0, atol=1e-9)


def test_the_calibration_files_hold_the_camera_without_drift(scenario, tmp_path):
    still = _short("st16-drift.toml", camera__drift={})
    simulation, fixed = simulate(scenario, 1), simulate(still, 1)
    np.testing.assert_array_equal(simulation.true.camera.parameters, fixed.true.camera.parameters)
    assert (fixed.calibration.truth.parameters == fixed.true.camera.parameters).all()
    with np.load(write_simulation(simulation, tmp_path)["truth"]) as truth:
        for part in ("calibration", "validation"):
            np.testing.assert_array_equal(
                truth[f"{part}.parameters"], getattr(simulation, part).truth.parameters
            )


def test_the_cone_of_the_field_holds_every_camera(scenario):
    camera = simulate(scenario, 1).true.camera
    parameters = camera.parameters + np.array([[0.0], [-3.0], [3.0], [-3.0]]) * SIGMA * 20.0
    middle, radius = field_of_view(camera, parameters)
    single = [field_of_view(camera, row[None])[1] for row in parameters]
    assert radius == pytest.approx(max(single), rel=1e-12)
    assert radius > single[0] * 1.01
    assert middle @ camera.directions(np.array([971.5]), np.array([1295.5]))[0] == pytest.approx(1)


def test_stars_beyond_the_field_of_the_epoch_are_seen():
    """A focal length that shrinks by a tenth widens the field."""
    step = {"at_s": 0.0, "offset_sigma": {"f_m": -200.0}}
    simulation = simulate(_short("st16-drift.toml", camera__drift={"steps": [step]}), 1)
    camera, part = simulation.true.camera, simulation.calibration
    middle, radius = field_of_view(camera, camera.parameters[None])
    real = part.truth.star_id > 0
    frame = part.frames.exposure_of_star[real] // 2
    own = camera.with_parameters(part.truth.parameters[frame].T)
    s_d = own.directions(part.frames.row_px[real], part.frames.col_px[real])
    assert (np.arccos(s_d @ middle) > 1.03 * radius).sum() > 20


def _error(**drift):
    with pytest.raises(ConfigError) as caught:
        _short("st16-drift.toml", camera__drift=drift)
    return str(caught.value)


def test_names_of_other_models_are_all_listed():
    step = {"at_s": 10.0, "offset_sigma": {"k1": 1.0, "f_m": 1.0}}
    message = _error(per_kelvin={"k2": 0.1}, per_day={"f": 0.1, "f_m": 0.1}, steps=[step])
    for place in ("per_kelvin.k2", "per_day.f", "steps.0.offset_sigma.k1"):
        assert f"camera.drift.{place}: not a parameter of wang" in message
    assert "f_m" not in message


# The field is 0.16 rad from the middle to its edge: a1 = 5 and more would fold the map there.
FOLD = 800.0


@pytest.mark.parametrize(
    ("drift", "told"),
    [
        ({"per_kelvin": {"a1_rad": FOLD / 8.0}}, "detector 0 s after the epoch at 12 deg C"),
        ({"per_day": {"a1_rad": FOLD}}, "93885 s after the epoch at 12 deg C"),
        (
            {"steps": [
                {"at_s": 100.0, "offset_sigma": {"a1_rad": FOLD}},
                {"at_s": 200.0, "offset_sigma": {"a1_rad": -FOLD}},
            ]},
            "100 s after the epoch at 12 deg C",
        ),
        (
            {
                "per_day": {"a1_rad": FOLD * 86.4},
                "steps": [{"at_s": 1000.0, "offset_sigma": {"a1_rad": -FOLD}}],
            },
            "999.999 s after the epoch at 12 deg C",
        ),
        ({"per_kelvin": {"b2_per_m2": -30.0 / 8.0}}, "detector 0 s after the epoch at 28 deg C"),
        ({"per_kelvin": {"a1_rad": 1e7}}, "camera.drift.per_kelvin.a1_rad"),
        ({"steps": [{"at_s": 0.0001, "offset_sigma": {"f_m": 1.0}}]}, "milliseconds"),
        ({"steps": [{"at_s": 1.0, "offset_sigma": {}}]}, "camera.drift.steps.0.offset_sigma"),
        ({"steps": [{"at_s": 1.0, "offset_sigma": {"f_m": 1.0}, "for_s": 3.0}]}, "for_s"),
        ({"steps": 3}, "camera.drift.steps"),
        ({"per_hour": {"f_m": 1.0}}, "camera.drift.per_hour"),
    ],
)  # fmt: skip
def test_single_errors_of_the_drift(drift, told):
    assert told in _error(**drift)


def test_a_file_with_errors_elsewhere_tells_of_the_drift_too(tmp_path):
    text = (FOLDER / "st16-step.toml").read_text()
    for old, new in (
        ('"../st16.toml"', f'"{FOLDER.parent / "st16.toml"}"'),
        ("{ f_m = 2.0, m0_px = 0.5 }", "{ a1_rad = 800.0 }"),
        ("sd_px = 0.4", "sd_px = -0.4"),
    ):
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    assert "noise.sd_px" in str(caught.value)
    assert "one-to-one over the detector 17500 s after the epoch" in str(caught.value)


def test_shipped_scenarios_drift_as_they_say():
    step = simulate(load_scenario(FOLDER / "st16-step.toml"), 1)
    offset, _ = _offsets(step)
    changed = np.flatnonzero(np.diff(offset[:, F]))
    assert len(changed) == 1
    assert changed[0] == pytest.approx(len(offset) / 2, abs=0.02 * len(offset))
    np.testing.assert_allclose(offset[-1], [2.0, 0.5, 0, 0, 0, 0, 0, 0], rtol=0, atol=1e-9)
    for name in ("st16-drift.toml", "st16-step.toml"):
        scenario = load_scenario(FOLDER / name)
        assert scenario.visibility.keep_flagged == 0.0
        assert scenario.noise.sd_px == scenario.sensor.noise.sd_px
