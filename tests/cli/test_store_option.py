"""A store is named by a folder; a URL is refused before anything is read or made."""

import pytest
from conftest import ROOT

from stcal.cli import main

CONFIG = str(ROOT / "configs" / "st16.toml")
COMMANDS = {
    "ingest": ["ingest", CONFIG, "--config", CONFIG],
    "match": ["match", "--sensor", "ST16-1", "--calibration", CONFIG, "--out", "out"],
    "quarantine": ["quarantine", "list"],
}


@pytest.mark.parametrize("command", COMMANDS)
def test_url_is_refused_and_makes_no_folder(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code = main([*COMMANDS[command], "--store", "s3://bucket/store"])
    assert code == 3
    assert "s3://bucket/store: a store is a folder" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
