"""The study of Zhang et al. 2024: its document, published values, and how findings are judged."""

from __future__ import annotations

import copy
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT

from stcal.cli.study_zhang import command
from stcal.errors import StcalError
from stcal.execution import scheduler
from stcal.simulate import load_scenario
from stcal.studies.findings import FAILS, HOLDS, PARTLY
from stcal.studies.zhang import run_study
from stcal.studies.zhang_findings import findings
from stcal.studies.zhang_paper import NAMES, published
from stcal.studies.zhang_runs import FILTERS, OURS, PAPER

SCENARIO = ROOT / "configs" / "scenarios" / "zhang2024.toml"
RUNS = 6


@pytest.fixture(scope="module")
def study() -> dict[str, Any]:
    """A short study as its file has it."""
    with scheduler(2, "processes") as mapper:
        document = run_study(load_scenario(SCENARIO), RUNS, 1, mapper, 60.0, 30.0)
    return json.loads(json.dumps(document, allow_nan=False))


def lengths(group: Any) -> set[int]:
    """Lengths of all lists of numbers below."""
    if isinstance(group, dict):
        return set().union(*(lengths(value) for value in group.values()))
    return {len(group)} if isinstance(group, list) else set()


def test_the_document_is_complete(study: dict[str, Any]) -> None:
    assert study["schema"] == "stcal.study.zhang/1"
    assert study["paper"] == json.loads(json.dumps(published()))
    convergence = study["convergence"]
    assert list(convergence["filters"]) == list(FILTERS)
    assert lengths(convergence) == {len(convergence["t_s"])}
    assert lengths(study["mean_square"]) == {len(study["mean_square"]["t_s"])}
    assert convergence["t_s"][-1] == study["errors"]["t_s"] == 60.0
    for name in FILTERS:
        for key, values in study["errors"]["filters"][name].items():
            assert list(values) == list(NAMES), key
            assert all(math.isfinite(value) for value in values.values())
    assert [level["noise_px"] for level in study["noise_levels"]] == [0.05, 0.1, 0.2, 0.5, 1.0]
    assert [case["case"] for case in study["low_frequency"]] == ["common", "field", "both"]
    for cameras in study["alignment"]["cameras"].values():
        for found in cameras.values():
            assert len(found["angle_deg"]) == len(study["alignment"]["t_s"])
    assert len(study["findings"]) == 9


def test_the_start_is_the_initial_calibration(study: dict[str, Any]) -> None:
    parameters = study["settings"]["parameters"]
    assert parameters["true"] == dict(zip(NAMES, (500, 530, 0.074, 2e-8, -1e-14), strict=True))
    for name in NAMES:
        off = abs(parameters["initial"][name] - parameters["true"][name])
        assert 0.0 < off < parameters["prior_sd"][name]


def test_errors_fall_and_agree_with_bound_and_sd(study: dict[str, Any]) -> None:
    ours = study["convergence"]["filters"][OURS]
    for name in NAMES:
        assert ours["sd"][name][-1] < 0.5 * ours["sd"][name][0]
        assert ours["rms"][name][-1] < study["settings"]["parameters"]["prior_sd"][name]
        assert ours["sd"][name][-1] == pytest.approx(study["errors"]["bound"][name], rel=0.1)
    # Six runs of five correlated parameters.
    z = np.array(list(study["errors"]["filters"][OURS]["consistency"].values()))
    assert 0.5 < np.sqrt((z**2).mean()) < 1.6


def test_the_papers_level_is_the_first_stage_itself(study: dict[str, Any]) -> None:
    assert study["noise_levels"][2]["filters"][PAPER] == study["errors"]["filters"][PAPER]


def test_the_same_seed_gives_the_same_numbers() -> None:
    scenario = load_scenario(SCENARIO)
    with scheduler(2) as mapper:
        found = [
            run_study(scenario, 2, seed, m, length_s=8.0, alignment_s=5.0)
            for seed, m in ((3, map), (3, mapper), (4, map))
        ]
    for document in found:
        document["created_utc"] = ""
    assert found[0] == found[1]
    assert found[0]["errors"] != found[2]["errors"]


def clear(document: dict[str, Any]) -> dict[str, Any]:
    """Return a document with the clear numbers of a long study where a finding looks."""
    result = copy.deepcopy(document)
    found = result["convergence"]["filters"][PAPER]["converged"]
    found["averaged"] = dict.fromkeys(NAMES, 50.0)
    found["absolute"] = dict.fromkeys(NAMES, 200.0) | {"k2_per_px4": None}
    bound = (0.83, 0.85, 2.3e-6, 2.5e-10, 4.6e-16)
    result["errors"]["bound"] = dict(zip(NAMES, bound, strict=True))
    square = result["mean_square"]
    square["t_s"], square["bound"]["optical"] = [0.0, 100.0, 500.0], [99.0, 1.4, 0.26]
    for group in square["filters"].values():
        group.update(optical=[99.0, 1.5, 0.3], averaged=[9.0, 0.01, 0.003], image=[1.0, 0.1, 0.01])
    largest = result["distortion"][PAPER]["largest"]["distortion"]
    largest.update(px=0.03, row_px=-0.5, col_px=1023.5)
    for k, level in enumerate(result["noise_levels"]):
        level["filters"][PAPER]["rms"] = dict.fromkeys(NAMES, 0.1 * 2.0**k)
    for case, size in zip(result["low_frequency"], (1.0, 5.0, 5.0), strict=True):
        case["filters"][OURS]["consistency"] = dict.fromkeys(NAMES, size)
    for name, size in zip(FILTERS, (1.4, 1.0, 1.0, 1.0), strict=True):
        group = result["errors"]["filters"][name]
        group["over_bound"] = group["consistency"] = dict.fromkeys(NAMES, size)
    section = result["alignment"]
    section["t_s"] = [1.0, 10.0, 100.0, 300.0]
    for camera in section["cameras"].values():
        camera["linear"]["angle_deg"] = [0.02, 0.0071, 0.007, 0.007]
        camera["linear"]["read"].update(element=8e-5, diagonal=4e-6, angle_deg=0.007)
    return result


def mounting(document: dict[str, Any]) -> dict[str, Any]:
    return document["alignment"]["cameras"][PAPER]["linear"]


# Place of the finding, its verdict before and after, and what changes.
FLIPS = {
    "single runs converge too": (0, PARTLY, HOLDS, lambda d: d["convergence"]["filters"][PAPER][
        "converged"]["absolute"].update(k2_per_px4=299.0)),
    "an average does not converge": (0, PARTLY, FAILS, lambda d: d["convergence"]["filters"][PAPER][
        "converged"]["averaged"].update(f_m=301.0)),
    "the bound allows an average": (1, FAILS, PARTLY, lambda d: d["errors"].update(
        bound={name: 0.05 * value for name, value in d["errors"]["bound"].items()})),
    "the bound allows the errors": (1, FAILS, HOLDS, lambda d: d["errors"].update(
        bound={name: 0.005 * value for name, value in d["errors"]["bound"].items()})),
    "the square is allowed": (2, PARTLY, HOLDS, lambda d: d["mean_square"]["bound"].update(
        optical=[1.0, 0.1, 0.001])),
    "no average has the square": (2, PARTLY, FAILS, lambda d: d["mean_square"]["bound"].update(
        optical=[1.0, 11.0, 0.2])),
    "distortion is larger": (3, HOLDS, PARTLY, lambda d: d["distortion"][PAPER]["largest"][
        "distortion"].update(px=0.2)),
    "distortion is central": (3, HOLDS, PARTLY, lambda d: d["distortion"][PAPER]["largest"][
        "distortion"].update(row_px=512.0)),
    "a level errs less": (4, HOLDS, PARTLY, lambda d: d["noise_levels"][3]["filters"][PAPER][
        "rms"].update(f_m=0.01, x0_px=0.01)),
    "a distortion does nothing": (5, PARTLY, HOLDS, lambda d: [
        case["filters"][OURS].update(consistency=dict.fromkeys(NAMES, 1.0))
        for case in d["low_frequency"]]),
    "a displacement matters": (5, PARTLY, FAILS, lambda d: d["low_frequency"][0]["filters"][
        OURS].update(consistency=dict.fromkeys(NAMES, 2.0))),
    "the products lose nothing": (6, PARTLY, HOLDS, lambda d: d["errors"]["filters"][PAPER].update(
        over_bound=dict.fromkeys(NAMES, 1.0), consistency=dict.fromkeys(NAMES, 1.1))),
    "the products lose most": (6, PARTLY, FAILS, lambda d: d["errors"]["filters"][PAPER].update(
        over_bound=dict.fromkeys(NAMES, 3.0))),
    "the mounting is far off": (7, HOLDS, PARTLY, lambda d: mounting(d)["read"].update(
        angle_deg=0.05)),
    "the mounting is much better": (7, HOLDS, FAILS, lambda d: mounting(d)["read"].update(
        angle_deg=1e-4, element=1e-6, diagonal=1e-7)),
    "the mounting settles late": (8, HOLDS, FAILS, lambda d: mounting(d).update(
        angle_deg=[0.02, 0.02, 0.02, 0.007])),
}  # fmt: skip


@pytest.mark.parametrize("case", FLIPS)
def test_a_verdict_follows_the_numbers(case: str, study: dict[str, Any]) -> None:
    place, before, after, change = FLIPS[case]
    document = clear(study)
    found = findings(document)
    assert found[place]["verdict"] == before
    change(document)
    again = findings(document)
    assert again[place]["verdict"] == after
    assert again[place]["here"] != found[place]["here"]
    others = [k for k in range(9) if k != place]
    assert [again[k]["verdict"] for k in others] == [found[k]["verdict"] for k in others]


def test_published_errors_below_the_bound_are_named(study: dict[str, Any]) -> None:
    here = findings(clear(study))[1]["here"]
    below = here[here.index("Published errors below it") :]
    assert "x0 83 times (1 %, 10 %)" in below
    assert "y0 28 times (3 %, 28 %)" in below
    assert "f 2 times" in below
    assert "k1" not in below
    assert "6889 times as many images" in below


def test_missing_numbers_are_no_success(study: dict[str, Any]) -> None:
    document = clear(study)
    document["errors"]["bound"] = dict.fromkeys(NAMES)
    document["convergence"]["filters"][PAPER]["converged"]["averaged"] = dict.fromkeys(NAMES)
    mounting(document)["read"] = dict.fromkeys(mounting(document)["read"])
    verdicts = [finding["verdict"] for finding in findings(document)]
    assert [verdicts[k] for k in (0, 1, 7)] == [FAILS] * 3


def run(*arguments: str) -> None:
    command.main(list(arguments), standalone_mode=False)


def test_the_command_writes_document_and_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run("--out", str(tmp_path), "--scenario", str(SCENARIO), "--runs", "2", "--workers", "2")
    document = json.loads((tmp_path / "study.json").read_text())
    assert document["runs"] == 2
    assert document["errors"]["t_s"] == 300.0
    assert document["convergence"]["t_s"][-1] == 500.0
    assert document["alignment"]["read_s"] == 200.0
    assert document["findings"] == findings(document)
    report = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert report.count('<div class="finding"') == 9
    shown = capsys.readouterr().out
    assert "Table 3. Errors of the parameters" in shown
    assert "report.html" in shown


def test_a_missing_scenario_is_named(tmp_path: Path) -> None:
    with pytest.raises(StcalError, match=r"none\.toml"):
        run("--out", str(tmp_path), "--scenario", str(tmp_path / "none.toml"))
