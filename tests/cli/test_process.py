"""The command as a process: how it ends, and what it says when nobody can be told."""

import os
import subprocess
import sys

import pytest
from conftest import ROOT

CONFIG = str(ROOT / "configs" / "st16.toml")
# Python's own end would take the object apart.
CODE = """
import sys
from stcal.cli import run
class Late:
    def __del__(self, write=sys.__stderr__.write):
        write("taken apart")
late = Late()
run()
"""


def process(*arguments, code=None, **options):
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | options
    how = ["-m", "stcal"] if code is None else ["-c", code]
    return subprocess.run(
        [sys.executable, *how, *arguments], text=True, check=False,
        env=os.environ | {"PYTHONPATH": str(ROOT)}, **options,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [(["sensor", "check", CONFIG], 0, "Sensor"), (["sensor", "check", "x.toml"], 3, "x.toml")],
)
def test_a_command_ends_without_taking_the_interpreter_apart(arguments, code, said):
    """Arrow's threads may still be letting go of Python objects."""
    ended = process(*arguments, code=CODE)
    assert ended.returncode == code
    assert said in ended.stdout + ended.stderr
    assert "taken apart" not in ended.stderr


@pytest.mark.parametrize("as_json", [[], ["--json"]])
def test_output_that_cannot_be_written(as_json):
    with open("/dev/full", "w") as full:
        ended = process("sensor", "check", CONFIG, *as_json, stdout=full)
        assert ended.returncode == 3
        assert ended.stderr == "stcal: No space left on device\n"
        assert process("sensor", "check", "x.toml", *as_json, stderr=full).returncode == 3


def test_without_standard_output():
    command = f"'{sys.executable}' -m stcal sensor check '{CONFIG}' --json >&-"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    ended = subprocess.run(
        ["sh", "-c", command], stderr=subprocess.PIPE, env=environment, check=False
    )
    assert (ended.returncode, ended.stderr) == (0, b"")
