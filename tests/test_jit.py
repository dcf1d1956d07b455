import numpy as np
import pytest

from stcal import jit
from stcal.matching.verify_kernels import log_choose


@pytest.fixture
def package(tmp_path, monkeypatch):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "x_kernels.py").write_text("one")
    (tmp_path / "a" / "other.py").write_text("unrelated")
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


def test_a_folder_that_the_user_names_is_used(package, monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "mine"))
    assert folder().parent == tmp_path / "mine"


def test_kernels_are_cached_there():
    compiled = jit.cache_folder()
    assert log_choose(10, 3) == pytest.approx(np.log(120.0))
    assert any(compiled.rglob("*.nbi"))
