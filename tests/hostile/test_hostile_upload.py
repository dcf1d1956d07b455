"""An upload's folder from elsewhere: its manifest may name nothing outside, and no endless file."""

import json
import os

import pytest

from stcal.errors import InputError
from stcal.uplink.approve import approve
from stcal.uplink.manifest import file_facts
from stcal.uplink.on_board import compare_with_upload

FACTS = file_facts(b"secret")
NAMES = ["../secret", "a/../../secret", "/etc/passwd", "..", ".", "", "\0", "x" * 300, "\ud800",
         "~/secret", "x/" * 3000 + "y"]  # fmt: skip


def upload(folder, files):
    folder.mkdir()
    document = {"schema": "stcal.upload/1", "files": files}
    (folder / "manifest.json").write_text(json.dumps(document))
    return folder


def refused(folder, said):
    """Check that both verify and approve refuse, and that nothing was written."""
    before = sorted(os.listdir(folder))
    for act in (lambda: approve(folder, "A", "2026-01-05T12:00:00Z"),
                lambda: compare_with_upload(folder, b"dump", None)):  # fmt: skip
        with pytest.raises(InputError, match=said) as error:
            act()
        assert str(folder) in str(error.value)
    assert sorted(os.listdir(folder)) == before


@pytest.mark.parametrize("name", NAMES, ids=range(len(NAMES)))
def test_names_in_a_manifest(tmp_path, name):
    (tmp_path / "secret").write_bytes(b"secret")
    refused(upload(tmp_path / "up", {name: FACTS}), "damaged|cannot be read|is not a file")


@pytest.mark.parametrize("facts", [None, [], "x", {}, {"sha256": None}, {"sha256": 10**30}])
def test_facts_of_a_file(tmp_path, facts):
    folder = upload(tmp_path / "up", {"a.tbl": facts})
    (folder / "a.tbl").write_bytes(b"secret")
    refused(folder, "damaged|is not what was built")


@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
def test_files_that_are_none(tmp_path, kind):
    folder = upload(tmp_path / "up", {"a.tbl": FACTS})
    match kind:
        case "pipe":
            os.mkfifo(folder / "a.tbl")
        case "device":
            (folder / "a.tbl").symlink_to("/dev/zero")
        case "folder":
            (folder / "a.tbl").mkdir()
    refused(folder, "is not a file")
