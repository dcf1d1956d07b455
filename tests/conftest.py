"""Shared objects: cameras, the ST-16's configuration, small simulated sensors."""

import os
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from stcal.cameras import CAMERAS, Camera
from stcal.catalog.catalogue import load_bundled, select
from stcal.config import SensorConfig, load_config
from stcal.matching import Matcher

ROOT = Path(__file__).parents[1]
REAL = ROOT.parent / "shared" / "data" / "real"


@cache
def st16_config() -> SensorConfig:
    return load_config(ROOT / "configs" / "st16.toml")


@cache
def st16_matcher() -> Matcher:
    section = st16_config().catalogue
    chosen = select(load_bundled(), section.limiting_magnitude, section.merge_separation_arcsec)
    return Matcher(chosen, st16_config())


@cache
def simulation(number: int, seed: int, frames: int):
    """A simulated ST-16 of Table III, shortened; validation is half as long."""
    from stcal.simulate import load_scenario, scenario_with, simulate

    scenario = load_scenario(ROOT / "configs" / "scenarios" / f"st16-{number}.toml")
    parts = {}
    for name, count in (("calibration", frames), ("validation", max(frames // 2, 20))):
        part = getattr(scenario, name)
        segments = [
            s.model_copy(update={"frames": max(1, count // len(part.segments))})
            for s in part.segments
        ]
        parts[name] = part.model_copy(update={"segments": segments})
    return simulate(scenario_with(scenario, **parts), seed)


@pytest.fixture
def config() -> SensorConfig:
    return st16_config()


@pytest.fixture
def matcher() -> Matcher:
    return st16_matcher()


@pytest.fixture
def st16_camera() -> Camera:
    """A camera with every effect present."""
    x = np.array([0.016 * 0.996, 980.0, 1250.0, 1.4e8, -1.2e3, 0.05, 0.02, 1.0008])
    return Camera(CAMERAS["wang"], 1944, 2592, 2.2e-6, x)


@pytest.fixture(scope="session")
def scene(tmp_path_factory):
    """The scene of the fault tests, made once a process."""
    import chaos_scene

    folder = tmp_path_factory.mktemp("chaos")
    os.environ["STCAL_CHAOS_TMP"] = str(tmp_path_factory.mktemp("told"))
    return chaos_scene.make(folder)
