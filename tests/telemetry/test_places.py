"""Places of stores: which URLs are read, what they list, and how failures are told."""

import errno
import pickle
import sys
from pathlib import Path

import fsspec
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from fsspec.implementations.memory import MemoryFileSystem

from stcal.errors import InputError
from stcal.telemetry.parquet import reading
from stcal.telemetry.places import Remote, listed, local_folder, place_of

FILES = ("store.json", "a/x=1/f", "a/x=2/f", "a/x=2/g", "a/x=3/deep/f", "a/y=1/f", "a/.h/f", "f")


@pytest.fixture
def memory():
    system = fsspec.filesystem("memory")
    yield system
    system.store.clear()
    system.pseudo_dirs[:] = [""]


@pytest.mark.parametrize("text", ["store", "/data/store", "C:/x", "s3:/bucket/x", "a b", "zip::x"])
def test_what_is_no_url_is_a_folder(text):
    assert place_of(text) == Path(text)
    assert local_folder(place_of(text)) == Path(text)


@pytest.mark.parametrize(
    ("text", "url"),
    [
        ("s3://bucket/store", "s3://bucket/store"),
        ("s3://bucket/a/store/", "s3://bucket/a/store"),
        ("s3://bucket", "s3://bucket"),
        ("gs://bucket/at:noon/x@y", "gs://bucket/at:noon/x@y"),
        ("abfs://box@account.dfs.core.windows.net/store", None),
        ("file:///data/store", "file:///data/store"),
    ],
)
def test_urls(text, url):
    found = place_of(text)
    assert str(found) == found.url == (url or text)
    assert pickle.loads(pickle.dumps(found)) == found
    below = found / "frames" / "f.parquet"
    assert (below.name, below.parent.parent) == ("f.parquet", found)
    with pytest.raises(InputError, match="is written in a folder"):
        local_folder(found)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("zip::s3://SECRET@bucket/x.zip", "chains"),
        ("simplecache::memory://SECRET", "chains"),
        ("s3://bucket/SECRET::file:///etc", "chains"),
        ("reference://SECRET", "a URL of s3://"),
        ("https://host/store?SECRET", "a URL of s3://"),
        ("S3://SECRET", "a URL of s3://"),
        ("s3://key:SECRET@bucket/store", "credentials"),
        ("s3://key:SEC/RET@bucket/SECRET", "credentials"),
        ("s3://SECRET@bucket/store", "credentials"),
        ("abfs://box:SECRET@account/store", "credentials"),
        ("s3://bucket/store?versionId=SECRET", "queries"),
        ("s3://", "no folder"),
        ("file:///", "no folder"),
    ],
)
def test_urls_that_are_refused_without_telling_secrets(text, said):
    with pytest.raises(InputError, match=said) as caught:
        place_of(text)
    assert "SECRET" not in str(caught.value)
    assert "RET@" not in str(caught.value)


@pytest.mark.parametrize(
    "pattern", ["x=*", "x=*/f", "**/f", "*", "store.json", "**/deep/*", "no/*"]
)
@pytest.mark.parametrize("where", ["", "a", "a/x=2", "none", "f"])
def test_lists_what_a_folder_lists(tmp_path, memory, pattern, where):
    for name in FILES:
        path = tmp_path / "s" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(name)
    # Beside it, with the same beginning.
    (tmp_path / "s2").mkdir()
    (tmp_path / "s2" / "f").write_text("")
    memory.put(str(tmp_path), "/all", recursive=True)
    wanted = [str(p.relative_to(tmp_path)) for p in listed(tmp_path / "s" / where, pattern)]
    if pattern == "**/f":
        wanted = [name for name in wanted if not (tmp_path / name).is_dir()]
    for root in (f"file://{tmp_path}", "memory://all"):
        base = Remote(f"{root}/s/{where}".rstrip("/"))
        assert [p.url.removeprefix(f"{root}/") for p in listed(base, pattern)] == wanted


ODD = ("a/../../x", "a//x", "x::y", "x?y", "\x1b[2J", "./x")


@pytest.mark.parametrize("name", ODD)
def test_names_that_may_lead_elsewhere_are_refused(memory, monkeypatch, name):
    memory.pipe("/s/good.parquet", b"")
    found = ["/s/good.parquet", f"/s/{name}.parquet"]
    monkeypatch.setattr(MemoryFileSystem, "find", lambda self, path: found)
    with pytest.raises(InputError, match=r"memory://s: lists '.*', which no store has"):
        Remote("memory://s").glob("**/*.parquet")


def test_names_from_outside_are_not_taken(memory, monkeypatch):
    found = ["/s2/x.parquet", "/etc/x.parquet", "/s", "/s/x.parquet"]
    monkeypatch.setattr(MemoryFileSystem, "find", lambda self, path: found)
    assert Remote("memory://s").glob("**/*.parquet") == [Remote("memory://s/x.parquet")]


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "gcsfs", None)
    with pytest.raises(InputError, match=r"gs://b/x: cannot be read: .*gcsfs"):
        Remote("gs://b/x").exists()
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    with pytest.raises(InputError, match=r"memory://x: .*install stcal-startracker\[remote\]"):
        Remote("memory://x").exists()


ERRORS = {
    "no answer in time": TimeoutError(),
    "access refused: Forbidden": PermissionError("Forbidden"),
    "Connection reset by peer": ConnectionResetError(errno.ECONNRESET, "Connection reset by peer"),
    "RuntimeError: one line": RuntimeError("one line\nand a page"),
    "no such file or bucket: b": FileNotFoundError("b"),
    "OSError": OSError(),
}


@pytest.mark.parametrize("said", ERRORS)
def test_failures_name_the_url_and_are_not_called_damage(memory, monkeypatch, said):
    remote = Remote("memory://s/x.parquet")
    with memory.open("/s/x.parquet", "wb") as stream:
        pq.write_table(pa.table({"a": list(range(1000))}), stream)

    def fail(*arguments, **options):
        raise ERRORS[said]

    with reading(remote, "fragment") as file:
        monkeypatch.setattr(type(memory.store["/s/x.parquet"]), "read", fail)
        with pytest.raises(InputError) as caught:
            file.read()
    assert str(caught.value).startswith(f"{remote}: cannot be read: {said}")
    for name in ("ls", "find", "info"):
        monkeypatch.setattr(MemoryFileSystem, name, fail)
    if said != "no such file or bucket: b":
        for action in (lambda: remote.glob("*"), lambda: remote.glob("a/*"), remote.exists):
            with pytest.raises(InputError, match=rf"{remote}: cannot be read: {said}"):
                action()
