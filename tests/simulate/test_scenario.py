"""Scenario files: validation that lists every error, the six sensors, and changes for studies."""

import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest

from stcal.errors import ConfigError
from stcal.simulate import calibrations, load_scenario, scenario_with, simulate
from stcal.simulate.sections import NadirPointing
from stcal.simulate.true_camera import is_one_to_one

CONFIGS = Path(__file__).parents[2] / "configs"
SCENARIOS = sorted((CONFIGS / "scenarios").glob("st16-[0-9].toml"))
# Enright 2018 Table III, in the order f m0 n0 b4 b2 a1 a2 g_y.
TABLE_III = {
    "ST16-1": [-8.54, 1.34, 1.68, 1.04, -1.03, 0.51, 0.15, 3.76],
    "ST16-2": [-8.04, 0.71, -8.37, 1.41, -1.17, -4.96, 0.47, 5.14],
    "ST16-3": [-8.17, 1.12, 1.61, 1.37, -1.22, 1.02, 0.41, 3.05],
    "ST16-4": [-9.46, 0.39, 8.08, 0.67, -0.90, 3.58, -0.10, 2.97],
    "ST16-5": [0.08, -2.59, 4.00, -0.10, 0.09, 2.34, -1.52, 0.36],
    "ST16-6": [-0.46, 3.16, -9.81, 0.44, -0.60, -4.93, 1.94, -1.30],
}
# Enright 2018 Table I: altitude, inclination, motions, sample period.
TABLE_I = {
    "ST16-1": (570, 97.8, {"nadir-pointing"}, 40),
    "ST16-2": (570, 97.8, {"nadir-pointing"}, 40),
    "ST16-3": (620, 98.4, {"nadir-pointing"}, 40),
    "ST16-4": (620, 98.4, {"nadir-pointing"}, 40),
    "ST16-5": (730, 97.7, {"slew"}, 10),
    "ST16-6": (670, 98.0, {"coarse-hold", "slew"}, 10),
}
SIGMA = [8e-6, 30, 30, 1e8, 1e3, 0.01, 0.01, 2e-4]


@pytest.fixture
def scenario():
    return load_scenario(SCENARIOS[0])


def _file(tmp_path, *changes):
    shutil.copy(CONFIGS / "st16.toml", tmp_path / "st16.toml")
    text = SCENARIOS[0].read_text().replace("../st16.toml", "st16.toml")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / "scenario.toml"
    path.write_text(text)
    return path


def test_six_scenarios_follow_the_papers_tables():
    assert len(SCENARIOS) == 6
    for path in SCENARIOS:
        scenario = load_scenario(path)
        altitude, inclination, motions, period = TABLE_I[scenario.sensor_id]
        assert scenario.orbit.altitude_km == altitude
        assert scenario.orbit.inclination_deg == inclination
        for part in (scenario.calibration, scenario.validation):
            assert {segment.motion for segment in part.segments} == motions
            assert part.sample_period_s == period
        initial, true = calibrations(scenario)
        change = (true.camera.parameters - initial.camera.parameters) / SIGMA
        np.testing.assert_allclose(change, TABLE_III[scenario.sensor_id], atol=1e-9)
        last = scenario.calibration.start_s + period * scenario.calibration.frames
        assert scenario.validation.start_s > last


def test_every_error_is_listed_at_once(tmp_path):
    path = _file(
        tmp_path,
        ("altitude_km = 570.0", "altitude_km = -5.0"),
        ("ltan_h = 10.5", "ltan_h = 25.0"),
        ('sensor_id = "ST16-1"', 'sensor_id = "XX-1"'),
        ("2014-02-10T06:00:00Z", "10 February"),
        ("b4_per_m4", "b5_per_m4"),
        ("sd_px = 0.41", "sd_px = -1\ncolour = 3"),
        ("sample_period_s = 40.0", "sample_period_s = 0.0123"),
        ("missing_probability = 0.02", "missing_probability = 1.5"),
        ('motion = "nadir-pointing"', 'motion = "tumble"'),
    )
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    message = str(caught.value)
    for part in (
        str(path), "orbit.altitude_km", "orbit.ltan_h", "sensor_id: 'XX-1'",
        "epoch: '10 February'", "camera.offset_sigma.b5_per_m4", "noise.sd_px", "noise.colour",
        "calibration.sample_period_s", "milliseconds", "detection.missing_probability", "tumble",
    ):  # fmt: skip
        assert part in message
    assert caught.value.exit_code == 3


def test_the_sensors_own_errors_come_with_the_scenarios(tmp_path):
    path = _file(tmp_path, ("altitude_km = 570.0", "altitude_km = -5.0"))
    config = tmp_path / "st16.toml"
    config.write_text(config.read_text().replace("rows = 1944", "rows = 0"))
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    message = str(caught.value)
    assert "detector.rows" in message
    assert "orbit.altitude_km" in message
    config.unlink()
    with pytest.raises(ConfigError, match=r"st16\.toml: cannot be read"):
        load_scenario(path)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("ltan_h = 10.5", ""), "exactly one of raan_deg and ltan_h"),
        (("ltan_h = 10.5", "ltan_h = 10.5\nraan_deg = 3.0"), "exactly one of"),
        (("boresight_b = [0.25, -0.9, -0.36]", "boresight_b = [0, 0, 0]"), "zero vector"),
        (("a1_rad    = 0.51", "a1_rad    = 4000"), "not one-to-one"),
        (('motion = "nadir-pointing"', 'motion = "coarse-hold"'), "needs target_deg"),
        (('schema = "stcal.scenario/1"', 'schema = "stcal.scenario/9"'), "schema"),
        (("[orbit]", "[orbit"), "not TOML"),
        (('sensor = "st16.toml"', ""), "sensor"),
        (('sensor = "st16.toml"', 'sensor = "a\\u0000b"'), "sensor.*null"),
        (("boresight_b = [0.25, -0.9, -0.36]", "boresight_b = [1e300, 0, 0]"), "boresight_b"),
        (("boresight_b = [0.25, -0.9, -0.36]", "boresight_b = [1e-300, 0, 0]"), "zero vector"),
        (("sample_period_s = 40.0", "start_s = 1e308\nsample_period_s = 40.0"), "start_s"),
        (("sample_period_s = 40.0", "start_s = 3.1e9\nsample_period_s = 40.0"), "year 2100"),
        (("sample_period_s = 40.0", "sample_period_s = 1e308"), "sample_period_s"),
        (("sample_period_s = 40.0", "sample_period_s = 1e6\nstart_s = 2.5e9"), "year 2100"),
        (("sample_period_s = 40.0", 'sample_period_s = "40.0"'), "sample_period_s"),
        (("2014-02-10T06", "2200-02-10T06"), "year 2100"),
        (
            ("sample_period_s = 40.0", f"first_frame_id = {10**15 + 1}\nsample_period_s = 40.0"),
            "first_frame_id",
        ),
        (
            ("false_stars_per_exposure = 0", "false_stars_per_exposure = 1001\n# 0"),
            "false_stars_per_exposure",
        ),
    ],
)
def test_single_errors(tmp_path, change, told):
    with pytest.raises(ConfigError, match=told):
        load_scenario(_file(tmp_path, change))
    with pytest.raises(ConfigError, match="cannot be read"):
        load_scenario(tmp_path / "nothing.toml")


def test_scenario_with_changes_nested_fields_and_validates(scenario):
    changed = scenario_with(
        scenario,
        noise__sd_px=0.2,
        calibration__segments__0__frames=7,
        camera__offset_sigma={"f_m": 1.0},
    )
    assert changed.noise.sd_px == 0.2
    assert changed.calibration.frames == 7
    assert isinstance(changed.calibration.segments[0], NadirPointing)
    assert scenario.calibration.frames == 400
    initial, true = calibrations(changed)
    assert true.camera.value("f_m") - initial.camera.value("f_m") == pytest.approx(8e-6)
    with pytest.raises(ConfigError, match=r"noise\.sd_px") as caught:
        scenario_with(scenario, noise__sd_px=-1.0, detection__width_mag=0.0)
    assert "detection.width_mag" in str(caught.value)
    with pytest.raises(ConfigError, match="telescope"):
        scenario_with(scenario, telescope=1)
    with pytest.raises(KeyError):
        scenario_with(scenario, nothing__here=1)


def test_one_to_one_finds_a_folded_map(scenario):
    _, true = calibrations(scenario)
    assert is_one_to_one(true.camera)
    names = true.camera.parameter_names
    folded = true.camera.parameters.copy()
    # B U turns back where 1 + 3 b2 rho^2 = 0: at rho = 3 mm, inside the corner at 3.56 mm.
    folded[names.index("b4_per_m4")] = 0.0
    folded[names.index("b2_per_m2")] = -1.0 / (3.0 * 0.003**2)
    assert not is_one_to_one(true.camera.with_parameters(folded))


def test_no_frame_is_looked_for_beyond_the_ephemeris(scenario):
    """Blind until 2100: an error of the scenario, and no warning of ERFA before it."""
    blind = scenario_with(
        scenario,
        epoch="2099-12-31T00:00:00Z",
        calibration__sample_period_s=1.0,
        calibration__segments__0__frames=5000,
        validation__start_s=40000.0,
        validation__sample_period_s=1.0,
        visibility__sun_exclusion_deg=180.0,
        visibility__keep_flagged=0.0,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ConfigError, match="before the year 2100"):
            simulate(blind, 1)
