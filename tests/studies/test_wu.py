"""The study of Wu et al. 2019: its document, published values, and how findings are judged."""

from __future__ import annotations

import copy
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT

from stcal.cli.study_wu import command
from stcal.config import load_config
from stcal.errors import ConfigError, UsageError
from stcal.execution import scheduler
from stcal.studies.findings import FAILS, HOLDS, OPEN, PARTLY
from stcal.studies.wu import run_study
from stcal.studies.wu_comparison import comparison
from stcal.studies.wu_criteria import pairs_of
from stcal.studies.wu_findings import findings
from stcal.studies.wu_paper import AD, SVD, published
from stcal.studies.wu_runs import methods_of
from stcal.studies.wu_scene import LIMITS, make_scene, take_images

CONFIG = ROOT / "configs" / "wu2019.toml"
RUNS, IMAGES = 2, 200
GROUPS = ("1", "2", "3")


@pytest.fixture(scope="module")
def study() -> dict[str, Any]:
    """A short study as its file has it."""
    with scheduler(2) as mapper:
        document = run_study(load_config(CONFIG), RUNS, 1, mapper, images=IMAGES)
    return json.loads(json.dumps(document, allow_nan=False))


def test_the_document_is_complete(study: dict[str, Any]) -> None:
    assert study["schema"] == "stcal.study.wu/1"
    assert study["paper"] == json.loads(json.dumps(published()))
    for number in GROUPS:
        group = study["groups"][number]
        assert sorted(group["methods"]) == sorted(methods_of(int(number)))
        for method in group["methods"].values():
            errors = list(method["error_percent"].values())
            lists = [*errors, *(method[k]["mean"] for k in ("a", "b", "constant_r"))]
            assert {len(values) for values in lists} == {RUNS}
            assert all(math.isfinite(value) for values in lists for value in values)
            assert method["us_per_image"] > 0.0 < method["us_settled"]
        assert len(group["bound"]["percentiles"]) == 101
        shown = group["convergence"]
        assert shown["image"][0] == 1
        assert shown["image"][-1] == IMAGES - 100
        curves = [*shown["a"].values(), *shown["b"].values(), shown["bound"]]
        assert {len(curve) for curve in curves} == {len(shown["image"])}
    assert set(study["paper"]["groups"]["2"]["methods"]) == set(methods_of(2))
    assert len(study["findings"]) == 15
    assert study["settings"]["machine"]


def test_published_values() -> None:
    groups = published()["groups"]
    ad = groups["1"]["methods"][AD]
    assert ad == {
        "a": {"mean": 0.535, "sd": 0.293},
        "b": {"mean": 10.824, "sd": 0.879},
        "us_per_image": 260120.0,
    }
    assert groups["3"]["methods"][SVD]["a"] == {"mean": 0.244, "sd": 0.003}
    tested = groups["2"]["methods"]
    assert tested["model 3"]["error_percent"]["k2"] == 15.7377
    assert tested["model 1"]["a"]["mean"] == 0.852
    assert tested[SVD]["error_percent"]["u0_px"] == -0.2159
    assert tested["values 2"] == {"a": {"mean": 0.384, "sd": 0.058}, "us_per_image": 5880.0}
    assert [groups[g]["stars"] for g in GROUPS] == [31.4, 19.1, 7.7]


def test_the_scene_is_the_papers(study: dict[str, Any]) -> None:
    settings = study["settings"]
    assert (settings["rows"], settings["cols"], settings["noise_sd_px"]) == (1080, 1920, 0.5)
    parameters = settings["parameters"]
    names = ("aspect", "f_m", "u0_px", "v0_px", "k1", "k2")
    assert parameters["true"] == dict(zip(names, (1, 0.016, 970, 550, -0.5, 0.5), strict=True))
    assert parameters["initial"] == dict(zip(names, (1, 0.0155, 960, 540, 0, 0), strict=True))
    for name in names:
        off = abs(parameters["initial"][name] - parameters["true"][name])
        assert off <= 1.001 * parameters["prior_sd"][name]
    for number, stars in zip(GROUPS, (31.4, 19.1, 7.7), strict=True):
        group = study["groups"][number]
        assert group["stars"] == pytest.approx(stars, rel=0.06)
        assert group["stars_at_paper_magnitude"] < group["stars"]


def test_filters_reach_what_the_data_allow(study: dict[str, Any]) -> None:
    for number in GROUPS:
        group = study["groups"][number]
        bound = group["bound"]["mean"]
        efficient, ad, svd = (
            np.array(found["mean"])
            for found in (group["efficient"], *(group["methods"][m]["a"] for m in (AD, SVD)))
        )
        # A run's luck is a factor of two or three; both filters have the same.
        assert 0.5 < efficient.mean() / bound < 2.0
        assert 0.85 < ad.mean() / efficient.mean() < 1.15
        assert 0.7 < svd.mean() / efficient.mean() < 1.4
        assert group["methods"][AD]["expected"]["mean"] == pytest.approx(bound, rel=0.03)
        for method in group["methods"].values():
            assert method["expected"]["mean"] > 0.99 * bound
        # Criterion B is the noise of two centroids, 0.5 px of 37 arcsec each.
        assert group["methods"][AD]["b"]["mean"][0] == pytest.approx(26.0, rel=0.08)


def test_the_last_images_judge_the_estimate(study: dict[str, Any]) -> None:
    scene = make_scene(load_config(CONFIG), IMAGES - 100, 100)
    images = take_images(scene, np.random.default_rng((1, 0))).brighter(scene.brightest(LIMITS[1]))
    last = images.between(IMAGES - 100, IMAGES)
    method = study["groups"]["1"]["methods"][SVD]
    error = np.array([values[0] for values in method["error_percent"].values()]) / 100.0
    nominal = scene.true.parameters
    camera = scene.true.with_parameters(nominal + error * np.abs(nominal))
    pairs = pairs_of(last.known)
    a = pairs.rmse_arcsec(camera.directions(last.known.row_px, last.known.col_px))
    b = pairs.rmse_arcsec(camera.directions(last.row_px, last.col_px))
    for key, found in (("a", a), ("b", b)):
        assert method[key]["mean"][0] == pytest.approx(found.mean())
        assert method[key]["sd"][0] == pytest.approx(found.std())


def test_the_end_of_figure_6_is_the_estimate(study: dict[str, Any]) -> None:
    shown = study["groups"]["2"]["convergence"]
    for curve in shown["a"].values():
        assert curve[-1] < 0.2 * curve[0]
        assert curve[-1] == pytest.approx(shown["bound"][-1], rel=0.6)


# Criterion A of a clear study [arcsec], by method of group 2.
_CLEAR = {
    AD: 0.225, SVD: 0.24, "model 1": 0.26, "model 2": 0.28, "model 3": 0.5, "values 1,2,3": 0.2405,
    "values 1,2": 0.241, "values 1,3": 0.241, "values 1": 0.3, "values 2": 0.4, "values 3": 0.9,
}  # fmt: skip


def clear(document: dict[str, Any]) -> dict[str, Any]:
    """Return a document with the clear numbers of a long study where a finding looks."""
    result = copy.deepcopy(document)
    rng = np.random.default_rng(1)
    common = 1.0 + 0.3 * rng.uniform(-1.0, 1.0, size=20)
    result["runs"] = len(common)
    for number, group in result["groups"].items():
        group["stars"] = {"1": 32.0, "2": 16.0, "3": 8.0}[number]
        group["efficient"]["mean"] = list(0.224 * common)
        group["bound"] = {"mean": 0.234, "percentiles": list(np.linspace(0.1, 0.4, 101))}
        for name, method in group["methods"].items():
            level = _CLEAR[name]
            luck = common * (1.0 + 0.05 * rng.uniform(-1.0, 1.0, size=20))
            method["a"] = {"mean": list(level * luck), "sd": list(0.2 * level * luck)}
            method["constant_r"] = {"mean": list(2.0 * level * luck)}
            method["b"] = {"mean": list(26.0 + 0.01 * level * luck)}
            method["us_settled"] = 2.0 * group["stars"] if name == AD else 100.0
    observed = result["observability"]
    observed["best_model"] = {"1": 0.1, "2": 0.1, "3": 0.1, "4": 0.7}
    observed["best_model_outward"] = {"1": 0.1, "2": 0.1, "3": 0.1, "4": 0.7}
    observed["worst_value"] = {"1": 0.9, "2": 0.05, "3": 0.05}
    shown = result["groups"]["2"]["convergence"]
    shown["image"] = [1, 10, 100, 1000]
    shown["a"] = {AD: [9.0, 3.0, 0.9, 0.3], SVD: [9.0, 3.0, 0.9, 0.3]}
    return judged(result)


def judged(document: dict[str, Any]) -> dict[str, Any]:
    document["comparison"] = comparison(document)
    return document


def scale(document: dict[str, Any], method: str, group: str, key: str, factor: float) -> None:
    """Make a method's criterion A larger in all runs."""
    found = document["groups"][group]["methods"][method]["a"]
    found[key] = [factor * value for value in found[key]]


# Place of the finding, its verdict before and after, and what changes.
FLIPS: dict[str, Any] = {
    "one group misses the goal": (0, HOLDS, PARTLY, lambda d: scale(d, AD, "3", "mean", 1.06)),
    "values win in accuracy": (1, FAILS, HOLDS, lambda d: scale(d, SVD, "3", "mean", 0.85)),
    "values win in time": (1, FAILS, HOLDS, lambda d: d["groups"]["1"]["methods"][SVD].update(
        us_settled=60.0)),
    "the time is quadratic": (2, HOLDS, FAILS, lambda d: [group["methods"][AD].update(
        us_settled=0.05 * group["stars"] ** 2) for group in d["groups"].values()]),
    "the bound is higher": (3, HOLDS, PARTLY, lambda d: d["groups"]["2"]["bound"].update(mean=0.3)),
    "the bound is the published value": (3, HOLDS, FAILS, lambda d: d["groups"]["2"][
        "bound"].update(mean=0.46)),
    "luck is rare": (4, PARTLY, HOLDS, lambda d: d["groups"]["3"]["bound"].update(
        percentiles=list(np.linspace(0.23, 0.5, 101)))),
    "luck is usual": (4, PARTLY, FAILS, lambda d: d["groups"]["3"]["bound"].update(
        percentiles=list(np.linspace(0.1, 0.3, 101)))),
    "model 4 is best in one order": (5, HOLDS, PARTLY, lambda d: d["observability"].update(
        best_model={"1": 0.3, "2": 0.2, "3": 0.1, "4": 0.4})),
    "another model observes better": (5, HOLDS, FAILS, lambda d: d["observability"].update(
        best_model={"1": 0.9, "2": 0.0, "3": 0.0, "4": 0.1},
        best_model_outward={"1": 0.9, "2": 0.0, "3": 0.0, "4": 0.1})),
    "another value is worse": (6, HOLDS, FAILS, lambda d: d["observability"].update(
        worst_value={"1": 0.2, "2": 0.1, "3": 0.7})),
    "another model is as good": (7, HOLDS, PARTLY, lambda d: scale(
        d, "model 1", "2", "mean", 0.2405 / 0.26)),
    "another model is better": (7, HOLDS, FAILS, lambda d: scale(
        d, "model 1", "2", "mean", 0.9)),
    "one value is as good": (8, PARTLY, HOLDS, lambda d: [
        scale(d, f"values {values}", "2", "mean", factor)
        for values, factor in (("2", 0.58), ("1,2", 1.02), ("1,3", 1.02))]),
    "other values are better": (8, PARTLY, FAILS, lambda d: scale(
        d, "values 1,3", "2", "mean", 0.9)),
    "one value has a small sd": (9, HOLDS, PARTLY, lambda d: scale(
        d, "values 2", "2", "sd", 0.5)),
    "values lose accuracy": (10, HOLDS, PARTLY, lambda d: scale(d, SVD, "1", "mean", 1.2)),
    "values are steadier": (11, FAILS, PARTLY, lambda d: scale(d, AD, "1", "sd", 1.1)),
    "noise hides the camera": (12, HOLDS, PARTLY, lambda d: d["groups"]["1"]["methods"][
        SVD].update(b=d["groups"]["1"]["methods"][AD]["b"])),
    "values are faster in a group": (13, FAILS, PARTLY, lambda d: d["groups"]["1"]["methods"][
        SVD].update(us_settled=40.0)),
    "values converge late": (14, HOLDS, FAILS, lambda d: d["groups"]["2"]["convergence"][
        "a"].update(svd=[9.0, 3.0, 1.1, 0.3])),
    "values never converge": (14, HOLDS, FAILS, lambda d: d["groups"]["2"]["convergence"][
        "a"].update(svd=[9.0, 3.0, 1.1, 1.1])),
}  # fmt: skip


@pytest.mark.parametrize("case", FLIPS)
def test_a_verdict_follows_the_numbers(case: str, study: dict[str, Any]) -> None:
    place, before, after, change = FLIPS[case]
    document = clear(study)
    found = findings(document)
    assert found[place]["verdict"] == before
    change(document)
    again = findings(judged(document))
    assert again[place]["verdict"] == after
    assert again[place]["here"] != found[place]["here"]


def test_two_runs_cannot_tell_luck_from_skill(study: dict[str, Any]) -> None:
    document = clear(study)
    document["runs"] = 2
    verdicts = [finding["verdict"] for finding in findings(document)]
    assert [k for k, verdict in enumerate(verdicts) if verdict == OPEN] == [
        0, 1, 7, 8, 9, 10, 11, 12,
    ]  # fmt: skip


def test_the_noise_that_the_paper_shows(study: dict[str, Any]) -> None:
    found = clear(study)["comparison"]["published"]
    assert found["1"]["noise_px"] == pytest.approx(0.5 * 10.824 / 26.00235, rel=1e-3)
    assert found["2"][SVD]["over_bound"] == pytest.approx(0.465 / 0.234)
    noise = found["2"]["noise_px"]
    assert found["2"][SVD]["over_bound_at_noise"] == pytest.approx(0.465 / 0.234 * 0.5 / noise)
    assert found["3"][SVD]["luck"] == pytest.approx((0.244 - 0.1) / 0.3)


def run(*arguments: str) -> None:
    command.main(list(arguments), standalone_mode=False)


def test_the_command_equals_the_first_run_of_many(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], study: dict[str, Any]
) -> None:
    run("--out", str(tmp_path), "--config", str(CONFIG), "--runs", "1", "--images", str(IMAGES))
    document = json.loads((tmp_path / "study.json").read_text())
    assert document["runs"] == 1
    assert document["settings"] == study["settings"]
    assert document["observability"] == study["observability"]
    for number in GROUPS:
        one, many = (found["groups"][number]["methods"] for found in (document, study))
        for name, method in one.items():
            assert method["a"]["mean"] == many[name]["a"]["mean"][:1]
            assert len(set(many[name]["a"]["mean"])) == RUNS
    assert document["findings"] == findings(document)
    report = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert report.count('<div class="finding"') == 15
    shown = capsys.readouterr().out
    assert "Table 4. Angular distances" in shown
    assert "report.html" in shown


def test_another_camera_model_is_refused() -> None:
    config = load_config(ROOT / "configs" / "st16.toml")
    with pytest.raises(ConfigError, match="pinhole-radial"):
        run_study(config, 1, 1)


def test_too_few_images_are_refused() -> None:
    with pytest.raises(UsageError, match="150 images"):
        run_study(load_config(CONFIG), 1, 1, images=150)
