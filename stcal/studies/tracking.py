"""Study ``tracking``: filters on cameras that change in flight, against the simulated truth.

A focal length that follows the sensor's temperature around each orbit, a step of focal length and
principal point, and a constant camera whose temperature swings all the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from stcal.constants import URAD
from stcal.execution import OrderedMap, serial
from stcal.pipeline.describe import header
from stcal.pipeline.numbers import number
from stcal.report.document import TRACKING_SCHEMA
from stcal.simulate import Scenario
from stcal.studies.tracking_cases import CASES, Case
from stcal.studies.tracking_findings import findings
from stcal.studies.tracking_run import settled_frames, study_run

# One run's figures.
_Run = dict[str, Any]


def run_study(
    scenarios: Mapping[str, Scenario],
    seed: int,
    runs: int = 1,
    mapper: OrderedMap = serial,
) -> dict[str, Any]:
    """Run the study and return its document, schema ``stcal.study.tracking/1``.

    Parameters
    ----------
    scenarios : the simulated sensors by the names of CASES
    seed, runs : seeds ``seed`` to ``seed + runs - 1`` are run; figures show the first one
    mapper : ordered map over cases and seeds
    """
    work = [(name, seed + k) for name in CASES for k in range(runs)]
    one = partial(_one_run, scenarios=scenarios, shown=seed)
    found: dict[str, list[_Run]] = {name: [] for name in CASES}
    for (name, _), result in zip(work, mapper(one, work), strict=True):
        found[name].append(result)
    document: dict[str, Any] = {
        **header(TRACKING_SCHEMA, ", ".join(scenarios[name].sensor_id for name in CASES)),
        "seed": seed,
        "runs": runs,
        "cases": {
            name: _case(case, scenarios[name], found[name])
            for name, case in CASES.items()
            if case.walks
        },
        "temperature": {
            name: _temperature(case, scenarios[name], found[name])
            for name, case in CASES.items()
            if case.thermal
        },
    }
    return document | {"findings": findings(document)}


def _one_run(item: tuple[str, int], scenarios: Mapping[str, Scenario], shown: int) -> _Run:
    name, seed = item
    return study_run(CASES[name], scenarios[name], seed, with_series=seed == shown)


def _case(case: Case, scenario: Scenario, runs: Sequence[_Run]) -> dict[str, Any]:
    """Return one case of the document, its runs pooled."""
    frames = scenario.calibration.frames
    return {
        "sensor_id": scenario.sensor_id,
        "frames": frames,
        "settled_frames": settled_frames(frames),
        "sample_period_s": scenario.calibration.sample_period_s,
        "moving": list(case.moving),
        "step_frame": runs[0]["step_frame"],
        "sigma": {name: scale.sigma for name, scale in scenario.sensor.camera.scale.items()},
        "true_rms_urad": number(_rms_urad(runs, "true")),
        "variants": {name: _variant(runs, name) for name in runs[0]["variants"]},
        "series": runs[0]["series"],
        "blocks": runs[0]["blocks"],
    }


def _variant(runs: Sequence[_Run], name: str) -> dict[str, Any]:
    """Return one variant's figures over all runs."""
    measured = [run["variants"][name] for run in runs]
    sequential = [run["sequential"][name] for run in runs]
    innovations = [item["innovations"] for item in sequential]
    first, rms = sequential[0]["variant"], _rms_urad(runs, name)
    return {
        "process_noise": first["process_noise"],
        "temperature": list(first["temperature"]),
        "fallbacks": sum(len(item["events"]) for item in sequential),
        "nis_per_arc": _mean([item.get("per_arc") for item in innovations]),
        "nis_within": _mean([item.get("within") for item in innovations]),
        "rms_urad": number(rms),
        "rms_ratio": number(rms / _rms_urad(runs, "true")),
        "parameters": _consistency(measured),
        **_moving(measured),
    }


def _rms_urad(runs: Sequence[_Run], name: str) -> float:
    """Return the RMS arclength error [urad] over all runs."""
    squares, pairs = np.sum([run["squares"][name] for run in runs], axis=0)
    return float(np.sqrt(squares / pairs) / URAD) if pairs else float("nan")


def _consistency(measured: Sequence[_Run]) -> dict[str, dict[str, float | None]]:
    """Return shares averaged and errors averaged in the square, by parameter."""
    found = {}
    for name in measured[0]["parameters"]:
        runs = [item["parameters"][name] for item in measured]
        shares = {key: _mean([run[key] for run in runs]) for key in ("within_3sd", "within_1sd")}
        squares = {key: _mean([run[key] ** 2 for run in runs]) for key in ("rms", "rms_z")}
        errors = {key: None if s is None else s**0.5 for key, s in squares.items()}
        found[name] = shares | errors
    return found


def _moving(measured: Sequence[_Run]) -> dict[str, dict[str, Any]]:
    """Return how the moving parameters are followed, or back after a step; lags run by run."""
    if "back_after" in measured[0]:
        names = measured[0]["back_after"]
        return {"back_after": {n: [item["back_after"][n] for item in measured] for n in names}}
    return {
        "following": {
            name: {
                "part": _mean([item["following"][name]["part"] for item in measured]),
                "lag_s": [number(item["following"][name]["lag_s"]) for item in measured],
            }
            for name in measured[0]["following"]
        }
    }


def _mean(values: Sequence[float | None]) -> float | None:
    return number(float(np.mean(np.array(values, dtype=np.float64))))


def _temperature(case: Case, scenario: Scenario, runs: Sequence[_Run]) -> dict[str, Any]:
    """Return the decision of every run on parameters linear in temperature."""
    drift, scale = scenario.camera.drift.per_kelvin, scenario.sensor.camera.scale
    slopes = {name: drift.get(name, 0.0) * scale[name].sigma for name in case.thermal}
    return {
        "sensor_id": scenario.sensor_id,
        "true_slopes_per_k": slopes,
        "decisions": [run["sequential"]["thermal"]["temperature"] for run in runs],
    }
