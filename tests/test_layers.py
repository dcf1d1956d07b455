"""Imports point one way, and the core stays free of interface libraries."""

import ast
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "stcal"
LAYERS = [
    {"constants", "errors", "version", "atomic", "reading", "jit"},
    {"geometry", "frames", "times", "units"},
    {"cameras", "catalog", "attitude", "attitude_kernels"},
    {"config", "calibration"},
    {"matching", "residuals", "execution"},
    {"estimators", "metrics"},
    {"pipeline"},
    {"telemetry", "simulate", "report", "uplink"},
    {"operations", "studies"},
    {"cli", "__main__"},
]
RANK = {name: rank for rank, names in enumerate(LAYERS) for name in names}
INTERFACE = {"click", "rich", "pandas", "pyarrow", "matplotlib", "jinja2"}


def imports(path: Path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def test_layers():
    problems = []
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        if parts == ("__init__",):
            continue
        rank = RANK[parts[0]]
        for name in imports(path):
            top = name.split(".")
            if top[0] == "stcal" and len(top) > 1 and RANK.get(top[1], -1) > rank:
                problems.append(f"{path.name} imports {name}")
            if top[0] in INTERFACE and rank < RANK["telemetry"]:
                problems.append(f"{path.name} imports {top[0]}")
    assert not problems, problems
