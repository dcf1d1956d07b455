"""The study of cameras that change in flight, shortened: what it measures, finds and shows."""

from __future__ import annotations

import copy
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from stcal.cli import main
from stcal.errors import UsageError
from stcal.pipeline.filtering import Variant
from stcal.pipeline.sequential import fit_sequential
from stcal.report import html, tracking_content
from stcal.report.tables import tracking_tables
from stcal.simulate import load_scenario
from stcal.studies import tracking
from stcal.studies.tracking_cases import CASES, Followed, short_scenario, variants_of
from stcal.studies.tracking_findings import findings
from stcal.studies.tracking_measures import (
    back_after,
    consistency,
    following,
    foreseen,
    pairs_of_truth,
    squares_by_frame,
    step_frame,
    track,
)
from stcal.studies.tracking_run import settled_frames

SCENARIOS = Path(__file__).parents[2] / "configs" / "scenarios"
FRAMES = 300


def scenario_of(name: str, frames: int = FRAMES) -> Any:
    case = CASES[name]
    return short_scenario(case, load_scenario(SCENARIOS / f"{case.scenario}.toml"), frames)


@pytest.fixture(scope="session")
def study() -> dict[str, Any]:
    return tracking.run_study({name: scenario_of(name) for name in CASES}, seed=1)


@pytest.fixture(scope="session")
def thermal() -> Followed:
    """The drifting camera under the thermal model alone, which learns the slope soon."""
    from stcal.simulate import simulate
    from stcal.studies.scenarios import matcher_of

    scenario = scenario_of("drift", 120)
    simulation, matcher = simulate(scenario, 5), matcher_of(scenario.sensor)
    variant = Variant(process_noise={}, temperature=("f_m",))
    frames = [simulation.calibration.frames]
    result = fit_sequential(frames, simulation.initial, matcher, {}, variant)
    return Followed(simulation, matcher, {"thermal": result})


def focal_length(study: dict[str, Any], case: str, variant: str) -> dict[str, Any]:
    return study["cases"][case]["variants"][variant]["parameters"]["f_m"]


def test_process_noise_follows_the_drift_and_constants_do_not(study: dict[str, Any]) -> None:
    assert focal_length(study, "drift", "q")["within_3sd"] >= 0.97
    assert focal_length(study, "drift", "q")["rms_z"] < 1.3
    assert focal_length(study, "drift", "no_q")["within_3sd"] < 0.5
    assert (
        focal_length(study, "drift", "q")["rms"] < 0.2 * focal_length(study, "drift", "no_q")["rms"]
    )
    ratios = {k: v["rms_ratio"] for k, v in study["cases"]["drift"]["variants"].items()}
    assert ratios["thermal"] < 1.01 < ratios["q"] < 1.1 < 1.3 < ratios["no_q"]


def test_temperature_model_is_chosen_on_the_drift_alone(study: dict[str, Any]) -> None:
    drift, constant = (study["temperature"][name] for name in ("drift", "constant"))
    (chosen,), (refused,) = drift["decisions"], constant["decisions"]
    assert chosen["chosen"] is True
    assert refused["chosen"] is False
    assert refused["twice_log_evidence"] < 0 < 1000 < chosen["twice_log_evidence"]
    for decision, case in ((chosen, drift), (refused, constant)):
        slope, truth = decision["slopes_per_k"]["f_m"], case["true_slopes_per_k"]["f_m"]
        assert abs(slope["value"] - truth) < 4.0 * slope["sd"]
    assert drift["true_slopes_per_k"]["f_m"] == pytest.approx(2e-6)
    assert refused["range_c"][1] - refused["range_c"][0] > 7.0


def test_step_is_followed_with_process_noise_alone(study: dict[str, Any]) -> None:
    step = study["cases"]["step"]
    assert 0.2 * FRAMES < step["step_frame"] < 0.8 * FRAMES
    back = {name: variant["back_after"] for name, variant in step["variants"].items()}
    assert all(frames <= 20 for runs in back["q"].values() for frames in runs)
    assert back["no_q"]["f_m"] == [None]
    assert back["q_third"]["f_m"][0] > back["q"]["f_m"][0] > back["q_triple"]["f_m"][0]
    assert step["variants"]["no_q"]["rms_ratio"] > 1.3 > step["variants"]["q"]["rms_ratio"]


def test_watch_lets_all_variants_go_on(study: dict[str, Any]) -> None:
    cases = study["cases"].values()
    assert all(v["fallbacks"] == 0 for case in cases for v in case["variants"].values())


def test_document_is_complete_and_json(study: dict[str, Any]) -> None:
    assert study["schema"] == "stcal.study.tracking/1"
    assert json.loads(json.dumps(study, allow_nan=False)) == study
    names = scenario_of("drift").sensor.camera.scale
    for name, case in study["cases"].items():
        expected = variants_of(CASES[name], tuple(names))
        assert list(case["variants"]) == list(expected)
        for key, variant in case["variants"].items():
            assert variant["process_noise"] == expected[key].process_noise
            assert list(variant["parameters"]) == list(names)
            for figures in variant["parameters"].values():
                assert all(value is not None for value in figures.values())
            assert 0.5 < variant["nis_per_arc"] < 10.0
            assert variant["rms_ratio"] == pytest.approx(
                variant["rms_urad"] / case["true_rms_urad"]
            )
        lengths = {len(values) for values in case["blocks"].values() if isinstance(values, list)}
        assert lengths == {FRAMES // 25}
        around = case["series"].get("around_step")
        assert (around is None) == (name == "drift")
    # White noise of 0.4 px in both coordinates of both stars of an arc.
    assert study["cases"]["drift"]["true_rms_urad"] == pytest.approx(77.8, rel=0.05)


def test_series_are_departures_from_the_reference(study: dict[str, Any]) -> None:
    series = study["cases"]["drift"]["series"]["all"]
    truth = np.array(series["truth"]["f_m"])
    assert np.abs(truth).max() == pytest.approx(16e-6, rel=0.01)
    assert not np.any(series["truth"]["m0_px"])
    estimate = series["variants"]["q"]["f_m"]
    error = np.array(estimate["value"]) - truth
    inside = np.abs(error) < 3.0 * np.array(estimate["sd"])
    assert inside[settled_frames(FRAMES) :].mean() > 0.97


@pytest.mark.parametrize(
    ("place", "path", "value"),
    [
        (0, ("cases", "drift", "variants", "q", "parameters", "f_m", "within_3sd"), 0.9),
        (0, ("cases", "drift", "variants", "q", "following", "f_m", "part"), 0.5),
        (1, ("cases", "drift", "variants", "q", "parameters", "f_m", "rms_z"), 1.5),
        (2, ("cases", "drift", "variants", "no_q", "parameters", "f_m", "within_3sd"), 0.99),
        (2, ("cases", "drift", "variants", "no_q", "rms_ratio"), 1.01),
        (3, ("cases", "drift", "variants", "q_third", "parameters", "f_m", "rms"), "below q"),
        (4, ("cases", "drift", "variants", "thermal", "parameters", "f_m", "rms"), 1e-3),
        (5, ("temperature", "constant", "decisions", 0, "chosen"), True),
        (5, ("temperature", "drift", "decisions", 0, "chosen"), False),
        (6, ("cases", "step", "variants", "q", "back_after", "f_m", 0), None),
        (6, ("cases", "step", "variants", "q", "back_after", "m0_px", 0), 70),
        (6, ("cases", "step", "variants", "no_q", "back_after", "m0_px", 0), 3),
        (7, ("cases", "step", "variants", "q_all", "parameters", "f_m", "within_3sd"), 0.5),
        (7, ("cases", "drift", "variants", "q_all", "parameters", "f_m", "rms"), "below q"),
        (8, ("cases", "step", "variants", "no_q", "fallbacks"), 2),
    ],
)
def test_findings_turn_with_the_numbers(
    study: dict[str, Any], place: int, path: tuple[Any, ...], value: Any
) -> None:
    good = agreeing(study)
    before = [finding["verdict"] for finding in findings(good)]
    assert before == ["holds"] * 9
    parent = good
    for key in path[:-1]:
        parent = parent[key]
    assert path[-1] in parent or isinstance(parent, list)
    below = 0.99 * focal_length(study, "drift", "q")["rms"]
    parent[path[-1]] = below if value == "below q" else value
    after = [finding["verdict"] for finding in findings(good)]
    assert after[place] != "holds"
    assert after[:place] + after[place + 1 :] == before[:place] + before[place + 1 :]


def agreeing(study: dict[str, Any]) -> dict[str, Any]:
    """The study's document with figures of a long run where a short one is too short for them."""
    document = copy.deepcopy(study)
    focal_length(document, "drift", "q").update(within_1sd=0.7, rms_z=0.95)
    for case in ("drift", "step"):
        for figures in document["cases"][case]["variants"]["q_all"]["parameters"].values():
            figures["within_3sd"] = 0.99
    document["cases"]["step"]["variants"]["no_q"]["back_after"]["m0_px"] = [None]
    return document


def test_several_runs_are_pooled() -> None:
    one = {
        "parameters": {"f_m": {"within_3sd": 1.0, "within_1sd": 0.5, "rms": 3.0, "rms_z": 1.0}},
        "back_after": {"f_m": 4},
    }
    other = {
        "parameters": {"f_m": {"within_3sd": 0.5, "within_1sd": 0.7, "rms": 4.0, "rms_z": 2.0}},
        "back_after": {"f_m": None},
    }
    pooled = tracking._consistency([one, other])["f_m"]
    assert pooled == pytest.approx(
        {"within_3sd": 0.75, "within_1sd": 0.6, "rms": 12.5**0.5, "rms_z": 2.5**0.5}
    )
    assert tracking._moving([one, other]) == {"back_after": {"f_m": [4, None]}}
    squares = [{"squares": {"x": (8e-12, 2)}}, {"squares": {"x": (1e-12, 1)}}]
    assert tracking._rms_urad(squares, "x") == pytest.approx(3.0**0.5)


def test_consistency_of_normal_errors() -> None:
    rng = np.random.default_rng(0)
    sd = rng.uniform(1.0, 3.0, 200_000)
    found = consistency(sd * rng.normal(size=len(sd)), sd)
    assert found["within_3sd"] == pytest.approx(0.9973, abs=5e-4)
    assert found["within_1sd"] == pytest.approx(0.6827, abs=4e-3)
    assert found["rms_z"] == pytest.approx(1.0, abs=0.01)
    assert found["rms"] == pytest.approx(np.sqrt(np.mean(sd**2)), rel=0.01)


@pytest.mark.parametrize(("part", "lag_s"), [(1.0, 0.0), (0.9, 40.0), (0.5, -25.0)])
def test_following_tells_part_and_lag(part: float, lag_s: float) -> None:
    t_s = np.concatenate([np.arange(0.0, 3000.0, 15.0), np.arange(5000.0, 8000.0, 15.0)])
    speed = 2.0 * np.pi / 5800.0
    estimate = 7.0 + part * 16e-6 * np.sin(speed * (t_s - lag_s))
    found = following(estimate, 3.0 + 16e-6 * np.sin(speed * t_s), (t_s * 1e9).astype(np.int64))
    # To first order in the lag.
    assert found["part"] == pytest.approx(part, rel=2e-3)
    assert found["lag_s"] == pytest.approx(lag_s, abs=0.2)


def test_nothing_to_follow() -> None:
    time = np.arange(10, dtype=np.int64) * 10**10
    found = following(np.arange(10.0), np.full(10, 2.0), time)
    assert all(np.isnan(value) for value in found.values())


def test_back_after_needs_to_stay() -> None:
    sd, error = np.ones(100), np.zeros(100)
    assert back_after(error, sd, 40) == 0
    error[40:45] = 5.0
    assert back_after(error, sd, 40) == 5
    error[60] = -3.5
    assert back_after(error, sd, 40) == 21
    error[61::20] = 9.0
    assert back_after(error, sd, 40) is None
    assert back_after(error[:50], sd[:50], 40) is None


def test_step_is_found_or_missed() -> None:
    parameters = np.ones((10, 3))
    parameters[6:, 1] = 2.0
    assert step_frame(parameters) == 6
    with pytest.raises(UsageError, match="outside the simulated frames"):
        step_frame(parameters[:6])


def test_estimates_are_those_at_the_frames_temperature(thermal: Followed) -> None:
    result = thermal.results["thermal"]
    run = result.runs["thermal"]
    assert result.chosen == "thermal"
    found, truth = track(run), thermal.simulation.calibration.truth.parameters
    z = (found.value - truth)[-40:, 0] / found.sd[-40:, 0]
    assert np.abs(z).max() < 4.0
    # The sd at the last frame is the state's covariance carried over.
    slope = int(np.flatnonzero(run.filter.model.thermal)[0])
    row = np.zeros(run.filter.n_states)
    row[0] = run.filter.model.scale[0]
    warmth = run.history.temperature_c[-1] - run.filter.reference_temperature_c
    row[slope] = warmth * run.filter.model.scale[slope]
    sd = np.sqrt(row @ run.filter.covariance(run.state) @ row)
    assert found.sd[-1, 0] == pytest.approx(sd, rel=1e-6)
    assert found.sd[-1, 1] == pytest.approx(run.history.sd[-1, 1] * run.filter.model.scale[1])


def test_foresight_is_the_estimate_before(thermal: Followed) -> None:
    run = thermal.results["thermal"].runs["thermal"]
    found, estimates = foreseen(run), track(run).value
    np.testing.assert_allclose(found[0], thermal.simulation.initial.camera.parameters)
    np.testing.assert_allclose(found[1:, 1:], estimates[:-1, 1:])
    slope = run.history.x[9, -1] * run.filter.model.scale[-1]
    warming = run.history.temperature_c[10] - run.history.temperature_c[9]
    assert found[10, 0] == pytest.approx(estimates[9, 0] + slope * warming, rel=1e-12)


def test_squares_use_each_frames_own_camera(thermal: Followed) -> None:
    arcs, part = pairs_of_truth(thermal), thermal.simulation.calibration
    squares, pairs = squares_by_frame(thermal, arcs, part.truth.parameters)
    camera = thermal.simulation.true.camera
    frame = part.frames.exposure_of_star[arcs.selection.star[arcs.pair_i]] // 2
    for k in (3, 60, 119):
        own = arcs.departures(camera.with_parameters(part.truth.parameters[k]))[frame == k]
        assert squares[k] == pytest.approx((own**2).sum(), rel=1e-9)
        assert pairs[k] == len(own) > 0
    constant = np.tile(camera.parameters, (part.frames.n_frames, 1))
    assert squares_by_frame(thermal, arcs, constant)[0].sum() > 1.2 * squares.sum()


def test_shortened_step_stays_in_the_middle() -> None:
    scenario = load_scenario(SCENARIOS / "st16-step.toml")
    assert short_scenario(CASES["step"], scenario, None) is scenario
    short = scenario_of("step", 250)
    assert short.calibration.frames == 250
    before = scenario.camera.drift.steps[0].at_s - short.calibration.start_s
    assert 0 < before < 250 * 15.0 + 2100.0


def test_report_shows_tables_figures_and_findings(study: dict[str, Any]) -> None:
    page = html.RENDERERS["stcal.study.tracking/1"](study)
    assert len(re.findall("<svg ", page)) == 6
    assert "not available" not in page
    assert "http" not in page
    for shown in (
        "Following a drift",
        "After a step",
        "Temperature model",
        "f, m0 0.333 sigma per √h",
        "1 sigma per √h, each parameter",
        "Expected",
        "Linear in temperature",
    ):
        assert shown in page, shown
    q = focal_length(study, "drift", "q")
    assert f"{100 * q['within_3sd']:.1f} %" in page
    assert f"{1e6 * q['rms']:.2f}" in page
    assert page == html.RENDERERS["stcal.study.tracking/1"](json.loads(json.dumps(study)))


def test_tables_show_the_figures_in_their_columns() -> None:
    figures = {"within_3sd": 0.9, "within_1sd": 0.5, "rms": 2e-6, "rms_z": 1.25}
    variant = {
        "parameters": {"f_m": figures},
        "following": {"f_m": {"part": 0.99, "lag_s": [30.0, 36.0]}},
        "back_after": {"f_m": [4, 7], "m0_px": [None, 3]},
        "rms_urad": 81.0,
        "rms_ratio": 1.05,
        "fallbacks": 2,
    }
    lost = {**variant, "following": {"f_m": {"part": 0.1, "lag_s": [900.0, 950.0]}}}
    case = {"variants": {"q": variant, "no_q": lost}, "sigma": {"f_m": 8e-6}}
    document = {"cases": {"drift": case, "step": case}}
    _, no_q, q = tracking_content.drift_table(document).rows
    assert q == ("Q", "90.0 %", "50.0 %", "2.00", "1.25", "99.0 %", "33 ± 3", "81.0", "1.050", "2")
    assert no_q[0] == "No-Q"
    assert no_q[6] == "–"
    assert tracking_content.parameter_table(document, "drift").rows == (
        ("f", "90.0 % / 50.0 %", "90.0 % / 50.0 %"),
    )
    step = tracking_content.step_table(document).rows[-1]
    assert step[1:4] == ("4 to 7", "90.0 %", "2.00")
    assert step[4] == "3 to never"


@pytest.mark.parametrize("junk", [None, "text", 3, True, [1, "x", None], {"a": [{}]}, -1e308])
def test_damaged_documents_still_render(study: dict[str, Any], junk: object) -> None:
    render = html.RENDERERS["stcal.study.tracking/1"]
    for document in (*_damaged(study, junk), {"schema": study["schema"]}):
        assert "Findings" in render(document)
        tracking_tables(document, Console(file=io.StringIO()))


def _damaged(study: dict[str, Any], junk: object) -> list[dict[str, Any]]:
    """The document with a part of each level replaced, and no more than that drawn."""
    step, bare = study["cases"]["step"], {**study, "cases": {}}
    variants = {key: dict.fromkeys(variant, junk) for key, variant in step["variants"].items()}
    blocks = dict.fromkeys(step["blocks"], junk)
    series = {"all": dict.fromkeys(step["series"]["all"], junk), "around_step": junk}
    cases = [
        junk,
        dict.fromkeys(study["cases"], junk),
        {"step": dict.fromkeys(step, junk)},
        {"drift": {**step, "variants": variants, "blocks": {}, "series": {}}},
        {"step": {**step, "variants": {}, "blocks": blocks, "series": series}},
    ]
    decisions = {"drift": {"decisions": [dict.fromkeys(("chosen", "range_c"), junk)]}}
    temperatures: list[object] = [junk, {"drift": {"decisions": junk}}, decisions]
    return [
        *({**bare, "cases": case} for case in cases),
        *({**bare, "temperature": temperature} for temperature in temperatures),
        {**bare, "findings": [junk, {"title": junk}], "runs": junk, "seed": junk},
    ]


def test_terminal_shows_the_study_in_80_columns(study: dict[str, Any]) -> None:
    stream = io.StringIO()
    tracking_tables(study, Console(file=stream, width=80, color_system=None))
    assert "…" not in stream.getvalue()
    assert "After a step" in stream.getvalue()


def test_command_writes_what_the_core_returns(
    study: dict[str, Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    asked: list[Any] = []

    def core(scenarios: Any, seed: int, runs: int, mapper: Any) -> dict[str, Any]:
        asked.append((scenarios, seed, runs))
        return study

    monkeypatch.setattr(tracking, "run_study", core)
    command = ["study", "tracking", "--out", str(tmp_path), "--scenarios", str(SCENARIOS)]
    assert main([*command, "--seed", "3", "--runs", "2", "--frames", "300", "--json"]) == 0
    ((scenarios, seed, runs),) = asked
    assert (seed, runs) == (3, 2)
    assert {name: s.sensor_id for name, s in scenarios.items()} == {
        "drift": "ST16-7",
        "step": "ST16-8",
        "constant": "ST16-1",
    }
    assert scenarios["step"] == scenario_of("step")
    assert json.loads(capsys.readouterr().out) == study
    assert json.loads((tmp_path / "study.json").read_text()) == study
    assert "After a step" in (tmp_path / "report.html").read_text()
    # The report can be made again of its document.
    again = tmp_path / "again.html"
    assert main(["report", str(tmp_path / "study.json"), "--out", str(again)]) == 0
    assert again.read_text() == (tmp_path / "report.html").read_text()


def test_missing_scenarios_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["study", "tracking", "--out", str(tmp_path / "o"), "--scenarios", str(tmp_path)]
    assert main(command) == 3
    assert "st16-drift.toml" in capsys.readouterr().err
    assert main([*command, "--frames", "5"]) == 2
