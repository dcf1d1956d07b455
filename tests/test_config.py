import pytest
from conftest import ROOT

from stcal.config import config_from_json, config_json, config_sha256, load_config
from stcal.errors import ConfigError

ST16 = (ROOT / "configs" / "st16.toml").read_text()


def check(tmp_path, text):
    path = tmp_path / "sensor.toml"
    path.write_text(text)
    return load_config(path)


@pytest.mark.parametrize("path", sorted((ROOT / "configs").glob("*.toml")), ids=lambda p: p.stem)
def test_shipped_configurations_are_valid(path):
    assert load_config(path).sensor_ids


def test_every_error_is_listed_at_once(tmp_path):
    text = (
        ST16.replace("rows = 1944", "rows = 0")
        .replace("sd_px = 0.4", "sd_px = -1.0")
        .replace("f_m       = {", "focal = {")
        .replace("sigma = 1e3", "sigma = -1e3")
        .replace("minimum_matches = 4", 'minimum_matches = "four"\nmagic = 1')
    )
    with pytest.raises(ConfigError) as caught:
        check(tmp_path, text)
    message = str(caught.value)
    assert "sensor.toml" in message
    for part in (
        "detector.rows", "noise.sd_px", "scale.f_m is missing", "scale.focal is not a parameter",
        "matching.minimum_matches", "matching.magic", "camera.scale.b2_per_m2.sigma",
    ):  # fmt: skip
        assert part in message


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('model = "wang"', 'model = "fisheye"', "known: wang"),
        ('schema = "stcal.sensor/1"', 'schema = "stcal.sensor/9"', "schema"),
        ("pixel_size_m = 2.2e-6", "pixel_size_m = nan", "pixel_size_m"),
        ('sensor_ids = ["ST16-*"]', "sensor_ids = []", "sensor_ids"),
        ("[detector]", "[detector", "not TOML"),
        ("arcsec = 90.0", "arcsec = 3601.0", "catalogue.merge_separation_arcsec"),
        ("arcsec = 90.0", "arcsec = inf", "catalogue.merge_separation_arcsec"),
        ("sd_px = 0.4", "sd_px = 0.4\nphoton_sd_px = inf", "noise.photon_sd_px"),
        ("f_m = [0.0155, 0.0165]", "f_m = [0.0165, 0.0155]", "not below the largest"),
        ("f_m = [0.0155, 0.0165]", "f_m = [0.0155]", "uplink.limits.f_m"),
        ("f_m = [0.0155, 0.0165]", "zoom = [1.0, 2.0]", "uplink.limits: not a parameter: zoom"),
        ("hint_radius_deg = 0.3", "hint_radius_deg = 10.5", "matching.hint_radius_deg"),
        ("hint_radius_deg = 0.3", "pair_tolerance = 1", "matching.pair_tolerance"),
        ("pair_tolerance_urad = 600.0", "pair_tolerance_urad = 1e6", "pair_tolerance_urad"),
        ("star_tolerance_urad = 400.0", "star_tolerance_urad = 1e6", "star_tolerance_urad"),
        ("pair_limit_deg = ", "pair_limit_deg = 1", "matching.pair_limit_deg"),
        ("limiting_magnitude = 5.8", "limiting_magnitude = 31", "catalogue.limiting_magnitude"),
        ("limiting_magnitude = 5.8", "limiting_magnitude = -3", "catalogue.limiting_magnitude"),
        ("limiting_magnitude = 5.8", 'limiting_magnitude = "5.8"', "valid number"),
        ("rows = 1944", 'rows = "1944"', "valid integer"),
        ("rows = 1944", "rows = true", "valid integer"),
        ('name = "Sinclair Interplanetary ST-16"', 'name = ""', "name"),
        ('name = "Sinclair Interplanetary ST-16"', f'name = "{"x" * 101}"', "name"),
        ('name = "Sinclair', 'name = "\\u001b[31mSinclair', "cannot be printed"),
        ('["ST16-*"]', '["ST16-*", ""]', "sensor_ids.1"),
        ("limiting", 'path = "a\\u0000b"\nlimiting', "catalogue.path"),
    ],
)
def test_errors_say_what_is_wrong(tmp_path, old, new, message):
    assert old in ST16
    with pytest.raises(ConfigError, match=r"sensor\.toml") as caught:
        check(tmp_path, ST16.replace(old, new))
    assert message in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"absent\.toml"):
        load_config(tmp_path / "absent.toml")


def test_patterns_choose_sensors(tmp_path):
    config = check(tmp_path, ST16)
    assert config.applies_to("ST16-17")
    assert not config.applies_to("st16-17")
    assert not config.applies_to("OTHER")


def test_json_keeps_everything_and_the_hash_sees_changes(tmp_path):
    config = check(tmp_path, ST16.replace("limiting", 'path = "cat.npz"\nlimiting'))
    assert config.catalogue.path == str((tmp_path / "cat.npz").resolve())
    again = config_from_json(config_json(config), tmp_path)
    assert again == config
    assert config_sha256(again) == config_sha256(config)
    assert config_sha256(check(tmp_path, ST16)) != config_sha256(config)


def test_integers_pass_for_floats_and_bounds_are_inclusive(tmp_path):
    text = ST16.replace("arcsec = 90.0", "arcsec = 3600").replace("sd_px = 0.4", "sd_px = 1")
    text = text.replace("hint_radius_deg = 0.3", "hint_radius_deg = 10")
    config = check(tmp_path, text)
    assert config.catalogue.merge_separation_arcsec == 3600.0
    assert isinstance(config.noise.sd_px, float)


def test_a_loop_of_links_in_the_catalogue_path(tmp_path):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(ConfigError, match=r"sensor\.toml(.|\n)*catalogue\.path"):
        check(tmp_path, ST16.replace("limiting", 'path = "loop"\nlimiting'))
