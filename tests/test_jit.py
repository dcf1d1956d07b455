import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from stcal import jit
from stcal.matching.verify_kernels import log_choose

ROOT = Path(__file__).parents[1]


@pytest.fixture
def package(tmp_path, monkeypatch):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "x_kernels.py").write_text("one")
    (tmp_path / "a" / "other.py").write_text("unrelated")
    (tmp_path / "cameras").mkdir()
    (tmp_path / "cameras" / "model.py").write_text("one")
    monkeypatch.setattr(jit, "_PACKAGE", tmp_path)
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    jit.cache_folder.cache_clear()
    yield tmp_path
    jit.cache_folder.cache_clear()


def folder():
    jit.cache_folder.cache_clear()
    return jit.cache_folder()


def test_an_edit_of_any_kernel_gives_a_new_cache(package):
    before = folder()
    assert folder() == before
    (package / "a" / "other.py").write_text("changed")
    assert folder() == before
    (package / "a" / "x_kernels.py").write_text("two")
    assert folder() != before


def test_an_edit_of_a_camera_model_gives_a_new_cache(package):
    before = folder()
    (package / "cameras" / "model.py").write_text("two")
    assert folder() != before


def test_a_folder_that_the_user_names_is_used(package, monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "mine"))
    assert folder().parent == tmp_path / "mine"


def test_kernels_are_cached_there():
    compiled = jit.cache_folder()
    assert log_choose(10, 3) == pytest.approx(np.log(120.0))
    assert any(compiled.rglob("*.nbi"))


POINTERS = """
from numba import types
from stcal.jit import pointer

SIGNATURE = types.float64(types.float64)

@pointer(SIGNATURE)
def doubled(x):
    return 2.0 * x

@pointer(SIGNATURE)
def squared(x):
    return x * x

@pointer(types.float64(types.FunctionType(SIGNATURE), types.float64))
def after_one(function, x):
    return function(x + 1.0)

print(after_one(doubled, 2.0), after_one(squared, 2.0))
print(sum(after_one.stats.cache_hits.values()), len(after_one.signatures))
"""


def test_one_compiled_kernel_takes_any_pointer_and_is_found_on_disk(tmp_path):
    script = tmp_path / "pointers.py"
    script.write_text(POINTERS)
    environment = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(ROOT)}
    runs = [
        subprocess.run(
            [sys.executable, script], env=environment, capture_output=True, text=True, check=True
        )
        for _ in range(2)
    ]
    answers = [run.stdout.split() for run in runs]
    assert answers == [["6.0", "9.0", "0", "1"], ["6.0", "9.0", "1", "1"]]
    # Why it takes so long is said once, where nothing was compiled before.
    first, second = (run.stderr for run in runs)
    assert first.count("compiling kernels for this machine") == 1
    assert len(first.splitlines()) == 1
    assert second == ""


def test_caches_that_nobody_uses_any_more_are_removed(tmp_path):
    current, stale, used = (tmp_path / f"kernels-{digit * 16}" for digit in "abc")
    other = tmp_path / "kernels-of-mine"
    for folder in (current, stale, used, other):
        folder.mkdir()
        (folder / "x.nbi").write_text("")
    month = time.time() - 31 * 86400.0
    for folder in (current, stale, other):
        os.utime(folder, (month, month))
    jit.remove_stale(current)
    assert current.exists()
    assert used.exists()
    assert other.exists()
    assert not stale.exists()


ON_DEMAND = """
import sys
import stcal.pipeline.fit, stcal.estimators.sequential
from stcal.cameras.kernels import CAMERA_KERNELS
from stcal.residuals.kernels import RESIDUAL_KERNELS
CAMERA_KERNELS["wang"], RESIDUAL_KERNELS["arclength"], list(RESIDUAL_KERNELS)
unused = ["pass", "window", "filter", "ekf", "sqrf", "cosine", "direction", "pixel_radial"]
loaded = {name.split(".")[-1] for name in sys.modules}
print([name for name in unused if f"{name}_kernels" in loaded])
"""


def test_a_batch_fit_loads_only_the_kernels_that_it_runs():
    found = subprocess.run(
        [sys.executable, "-c", ON_DEMAND], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert found.stdout.strip() == "[]"
