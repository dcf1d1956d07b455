"""Compiled cameras against the vectorised ones."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from camera_cases import CASES

from stcal.cameras import CAMERAS
from stcal.cameras.kernels import CAMERA_KERNELS

ROOT = Path(__file__).parents[2]


def test_every_model_has_its_compiled_twin():
    assert CAMERA_KERNELS.keys() == CAMERAS.keys()


@pytest.mark.parametrize("name", CASES)
def test_twin_agrees_with_the_camera(name):
    camera = CASES[name].camera()
    m, n = CASES[name].centroids(500, seed=3)
    expected = camera.jacobian(m, n)
    found = tuple(np.full_like(values, np.nan) for values in expected)
    CAMERA_KERNELS[name](camera.parameters, camera.pixel_size_m, m, n, *found)
    for twin, values in zip(found, expected, strict=True):
        np.testing.assert_allclose(twin, values, rtol=1e-15, atol=0)


def test_cameras_themselves_do_not_load_numba():
    code = "import sys, stcal.cameras; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0
