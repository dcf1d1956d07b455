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


def test_check_loads_the_catalogue_that_a_file_names(capsys, tmp_path):
    from stcal.catalog.catalogue import BUNDLED

    text = (ROOT / "configs" / "st16.toml").read_text()
    content = BUNDLED.read_bytes()
    (tmp_path / "good.npz").write_bytes(content)
    (tmp_path / "cut.npz").write_bytes(content[:9999])
    for name in ("good", "cut", "absent"):
        named = text.replace("limiting_magnitude", f'path = "{name}.npz"\nlimiting_magnitude')
        if name == "absent":
            named = named.replace("rows = 1944", "rows = 0")
        (tmp_path / f"{name}.toml").write_text(named)
    files = [str(tmp_path / f"{name}.toml") for name in ("good", "cut", "absent")]
    assert main(["sensor", "check", *files, "--json"]) == 3
    document = json.loads(capsys.readouterr().out)
    assert [row["valid"] for row in document["files"]] == [True, False, False]
    assert "cut.npz: cut short" in document["files"][1]["error"]
    # Both errors of one file, and those of all files, at once.
    assert "absent.npz: no such file" in document["files"][2]["error"]
    assert "detector.rows" in document["files"][2]["error"]
    assert "cut.npz" in document["error"]
    assert "absent.npz" in document["error"]
