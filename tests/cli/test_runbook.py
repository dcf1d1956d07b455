"""docs/operations.md, typed step by step."""

import json
import re
import shlex
import shutil
from pathlib import Path

import pytest
from conftest import ROOT

from stcal.cli import main

PAGE = (ROOT / "docs" / "operations.md").read_text()


def commands_of(section: str) -> list[list[str]]:
    """The commands of a section's code blocks, continued lines joined."""
    text = PAGE.split(f"## {section}", 1)[1].split("\n## ", 1)[0]
    blocks = "".join(re.findall(r"```\n(.*?)```", text, re.DOTALL))
    lines = blocks.replace("\\\n", " ").splitlines()
    return [shlex.split(line) for line in lines if line.startswith("stcal ")]


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the page's paths name."""
    folder = tmp_path_factory.mktemp("shift")
    shutil.copytree(ROOT / "configs", folder / "configs")
    (folder / "sample_telemetry").mkdir()
    for path in (ROOT / "sample_telemetry").glob("ST16-2.*"):
        shutil.copy(path, folder / "sample_telemetry")
    return folder


def run(arguments: list[str], work: Path) -> int:
    expanded: list[str] = []
    for word in arguments[1:]:
        found = sorted(map(str, work.glob(word))) if "*" in word else []
        expanded += found or [word]
    return main([*expanded, "--json"])


def test_the_steps_of_a_shift(
    work: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(work)
    for section in ("1. Take in", "2. Refit", "3. Build"):
        for command in commands_of(section):
            assert run(command, work) == 0, command
    folder = work / "uplink" / "serial-0002"
    manifest = json.loads((folder / "manifest.json").read_text())
    assert all(gate["passed"] for gate in manifest["gates"].values())
    assert manifest["gates"]["files"]["figures"]["telemetry_sha256"]
    table = next(folder.glob("*.tbl"))
    approve, verify, crc = commands_of("4. Approve")
    assert run(approve, work) == 0
    assert run([*verify[:-1], str(table)], work) == 0
    assert run([*crc[:-1], manifest["crc16_arc"][table.name]], work) == 0
    assert run(crc, work) == 4
    capsys.readouterr()


def test_every_gate_is_explained() -> None:
    from stcal.uplink.gates import FIXED, GATES

    rows = re.findall(r"^\| `([a-z-]+)` \|(.*)$", PAGE, re.MULTILINE)
    assert [name for name, _ in rows] == list(GATES)
    assert {name for name, rest in rows if "Never overridden" in rest} == set(FIXED)


def test_the_plan_of_a_fleet_is_valid(work: Path, tmp_path: Path) -> None:
    from stcal.operations.plan import load_plan

    plan = re.search(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    assert plan is not None
    (tmp_path / "plan.toml").write_text(plan[1].replace("# readback", "readback").replace(
        "# overrides", "overrides"
    ))  # fmt: skip
    found = load_plan(tmp_path / "plan.toml")
    assert found.plan.sensors[0].overrides[0].gate == "limits"
