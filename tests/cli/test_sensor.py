import json

from conftest import ROOT

from stcal.cli import main


def test_check_lists_valid_files(capsys):
    files = sorted(str(p) for p in (ROOT / "configs").glob("*.toml"))
    assert main(["sensor", "check", *files, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [row["valid"] for row in document["files"]] == [True] * len(files)


def test_check_reports_every_broken_file(capsys, tmp_path):
    first, second = tmp_path / "a.toml", tmp_path / "b.toml"
    first.write_text("schema = 1")
    second.write_text("nonsense")
    assert main(["sensor", "check", str(first), str(second)]) == 3
    err = capsys.readouterr().err
    assert "a.toml" in err
    assert "b.toml" in err
    assert "detector" in err
