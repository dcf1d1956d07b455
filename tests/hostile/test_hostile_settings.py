"""Plans, targets, layouts, mappings and configurations with a hostile value at any place."""

import json
import os
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from stcal.config import load_config
from stcal.errors import ConfigError, InputError
from stcal.operations.plan import load_plan
from stcal.telemetry.mapping import load_mapping
from stcal.telemetry.packet_layout import load_layout
from stcal.uplink.target import load_target

ROOT = Path(__file__).parents[2]
CONFIGS = ROOT / "configs"
LONG = os.environ.get("STCAL_CHAOS") == "1"
PLAN = """
schema = "stcal.recalibration/1"
store = "store"
out = "out"
configs = ["st16.toml"]
target = "target.toml"
sources = ["*.csv"]
ingest_options = ["--workers", "1"]
fit = { method = "ekf", options = ["--anchor", "a"] }
[[sensors]]
sensor_id = "ST16-1"
onboard = "onboard.json"
readback = "dump.bin"
overrides = [{ gate = "change", reason = "because" }]
fit = { from = "2026-01-05", to = "2026-01-06" }
validate = { from = "2026-01-06" }
"""
VALUES = (
    "", " ", "\0", "../../x", "/etc/passwd", "a" * 100_000, "\x1b[2J", "<script>", "%s{0}", "nan",
    "9999-12-31T23:59:59Z", "0001-01-01", "--out=/x", 0, -1, 2**31, 2**63, 10**30, -(10**30), 0.0,
    -0.0, 1e308, 5e-324, float("nan"), float("inf"), True, [], {}, [[]], [""], {"": ""}, [None],
)  # fmt: skip
READERS = {
    "plan": (load_plan, None),
    "config": (load_config, CONFIGS / "st16.toml"),
    "layout": (load_layout, CONFIGS / "packets" / "st16.toml"),
    "text mapping": (load_mapping, CONFIGS / "mappings" / "yamcs.toml"),
    "arrow mapping": (load_mapping, CONFIGS / "mappings" / "parquet-frames.toml"),
    "cfe target": (load_target, CONFIGS / "targets" / "st16_cfs.toml"),
    "fprime target": (load_target, CONFIGS / "targets" / "zhang2024_fprime.toml"),
}


def toml(value):
    """Return a value as inline TOML; no value at all for None."""
    match value:
        case dict():
            return "{" + ", ".join(f"{json.dumps(k)} = {toml(v)}" for k, v in value.items()) + "}"
        case list():
            return "[" + ", ".join(toml(item) for item in value if item is not None) + "]"
        case str() | bool():
            return json.dumps(value).replace("\x7f", "\\u007f")
        case float():
            return repr(value)
    return str(value)


def places(value, place=()):
    """Yield the path of every value of a document."""
    inner = value.items() if isinstance(value, dict) else enumerate(value)
    for key, item in inner:
        yield (*place, key)
        if isinstance(item, dict | list):
            yield from places(item, (*place, key))


def with_value(document, place, value):
    changed = json.loads(json.dumps(document))
    inner = changed
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    return changed


@pytest.mark.parametrize("name", READERS)
def test_a_hostile_value_at_any_place(tmp_path, name):
    """It is refused by one error that names the file, or it is a value like others."""
    read, example = READERS[name]
    document = tomllib.loads(PLAN if example is None else example.read_text())
    pairs = [(place, value) for place in places(document) for value in VALUES]
    chosen = np.random.default_rng(0).permutation(len(pairs))[: None if LONG else 150]
    path, messages = tmp_path / "it.toml", []
    for place, value in (pairs[i] for i in chosen.tolist()):
        lines = (f"{json.dumps(k)} = {toml(v)}" for k, v in
                 with_value(document, place, value).items())  # fmt: skip
        path.write_text("\n".join(lines))
        try:
            read(path)
        except (ConfigError, InputError) as error:
            messages.append(str(error))
        except Exception as error:
            error.add_note(f"{place} = {value!r:.60}")
            raise
    assert all(str(path) in message for message in messages)
    assert len(messages) > len(chosen) // 3


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize(
    "content",
    [
        b"a = " + b"[" * 100_000,
        b"a = " + b"{b=" * 50_000,
        b"a" + b".a" * 500 + b" = 1",
        b"x = 1\na" + b' . "a"' * 50_000 + b" = 1",
        b"a = {b = 1, a" + b".a" * 50_000 + b" = 1}",
        b"[a" + b".a" * 50_000 + b"]",
        b"a = " + b"1" * 5000,
        b"\xff\xfe",
        b"a = \0",
        b"schema = 1979-05-27T07:32:00Z",
    ],
    ids=range(10),
)
def test_what_is_no_document(tmp_path, name, content):
    path = tmp_path / "it.toml"
    path.write_bytes(content)
    with pytest.raises((ConfigError, InputError), match=re.escape(str(path))):
        READERS[name][0](path)


NAMES = ["../x", "/etc/x", "..", ".", "a/b", "a\\b", "\0", "x" * 300, "", "<script>", "C:x", "\n"]
NAMES += ["index.html", "Recalibration.json"]


@pytest.mark.parametrize("sensor", NAMES)
def test_a_planned_sensor_stays_in_the_plans_folder(tmp_path, sensor):
    path = tmp_path / "plan.toml"
    path.write_text(PLAN.replace('"ST16-1"', json.dumps(sensor)))
    with pytest.raises(ConfigError, match="sensor_id"):
        load_plan(path)


@pytest.mark.parametrize("sensor", ["%2e%2e", "~root", "-x", "--out", "$HOME", "a b", "x.json"])
def test_odd_names_are_only_names(tmp_path, sensor):
    path = tmp_path / "plan.toml"
    path.write_text(PLAN.replace('"ST16-1"', json.dumps(sensor)))
    file = load_plan(path)
    assert (file.out / file.plan.sensors[0].sensor_id).resolve().parent == file.out.resolve()
