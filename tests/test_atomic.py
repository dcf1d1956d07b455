import os

import pytest

from stcal.atomic import write_bytes, write_text, write_with


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
