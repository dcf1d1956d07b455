"""The scene of the fault tests, made once a process."""

import os

import chaos_scene
import pytest


@pytest.fixture(scope="session")
def whole_scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("chaos")
    os.environ["STCAL_CHAOS_TMP"] = str(tmp_path_factory.mktemp("told"))
    return chaos_scene.make(folder)


@pytest.fixture
def scene(whole_scene):
    return whole_scene
