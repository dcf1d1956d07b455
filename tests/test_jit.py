import subprocess
import sys
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
    answers = [
        subprocess.run(
            [sys.executable, script], env=environment, capture_output=True, text=True, check=True
        ).stdout.split()
        for _ in range(2)
    ]
    assert answers == [["6.0", "9.0", "0", "1"], ["6.0", "9.0", "1", "1"]]
