import errno
import os

import numpy as np
import pytest

from stcal.atomic import staged, write_bytes, write_text, write_with
from stcal.pipeline.scratch import FolderScratch


def test_a_file_appears_whole_with_the_usual_permissions(tmp_path):
    path = tmp_path / "deep" / "file.txt"
    write_text(path, "ä\n")
    assert path.read_bytes() == b"\xc3\xa4\n"
    mask = os.umask(0)
    os.umask(mask)
    assert path.stat().st_mode & 0o777 == 0o666 & ~mask
    assert [p.name for p in path.parent.iterdir()] == ["file.txt"]


def test_a_failed_write_keeps_the_old_file_and_leaves_nothing(tmp_path):
    path = tmp_path / "file.bin"
    write_bytes(path, b"old")

    def fail(stream):
        stream.write(b"new, half")
        raise RuntimeError("disk on fire")

    with pytest.raises(RuntimeError):
        write_with(path, fail)
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["file.bin"]


def full(*_, **__):
    raise OSError(errno.ENOSPC, "no name")


def test_a_full_disk_is_named(tmp_path, monkeypatch):
    """The error of a write or an fsync has no name of its own."""
    monkeypatch.setattr(np, "save", full)
    with pytest.raises(OSError, match="No space left") as error:
        FolderScratch(tmp_path).put("stars", 3, np.zeros(4))
    assert error.value.filename == str(tmp_path / "stars" / "3.npy")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left") as error, staged(tmp_path, "last") as stage:
        (stage / "last").touch()
    assert error.value.filename == str(tmp_path)
