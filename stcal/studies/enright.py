"""Study ``enright``: the tests of Enright, Jovanovic & Vaz 2018, section III, on simulated ST-16s.

Each sensor is simulated with the offsets of Table III, recalibrated by every method of the paper,
and judged on telemetry that no fit has seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from stcal.calibration import Calibration
from stcal.cameras import Camera
from stcal.execution import OrderedMap, serial
from stcal.matching import Matcher
from stcal.pipeline.describe import header
from stcal.pipeline.numbers import number
from stcal.report.document import ENRIGHT_SCHEMA
from stcal.simulate import Scenario, Simulation, simulate
from stcal.studies.enright_findings import findings
from stcal.studies.enright_history import (
    convergence,
    ends,
    radial_difference,
    settling,
    tail_and_aggregate,
)
from stcal.studies.enright_paper import SHOWN, published
from stcal.studies.enright_runs import METHODS, REDUCED, Fits, fit_all, fit_filters
from stcal.studies.evaluation import TRUE, evaluate
from stcal.studies.scenarios import matcher_of


def run_study(
    scenarios: Mapping[int, Scenario],
    seed: int,
    mapper: OrderedMap = serial,
) -> dict[str, Any]:
    """Run the study and return its document, schema ``stcal.study.enright/1``.

    Parameters
    ----------
    scenarios : the simulated sensors by the paper's number
    seed : of the simulation; the same seed gives the same numbers
    mapper : ordered map over the sensors
    """
    one = partial(_numbered, seed=seed)
    sensors = list(mapper(one, sorted(scenarios.items())))
    numbers_run = [sensor["number"] for sensor in sensors]
    return {
        **header(ENRIGHT_SCHEMA, ", ".join(sensor["sensor_id"] for sensor in sensors)),
        "seed": seed,
        "shown": {
            what: sensor if sensor in numbers_run else numbers_run[0]
            for what, sensor in SHOWN.items()
        },
        "sensors": sensors,
        "findings": findings(sensors),
    }


def _numbered(item: tuple[int, Scenario], seed: int) -> dict[str, Any]:
    return study_sensor(*item, seed)


def study_sensor(sensor: int, scenario: Scenario, seed: int) -> dict[str, Any]:
    """Return everything that the study says about one sensor."""
    simulation, matcher = simulate(scenario, seed), matcher_of(scenario.sensor)
    frames, initial = simulation.calibration.frames, simulation.initial
    full = fit_all(frames, initial, matcher)
    reduced = fit_all(frames, initial, matcher, REDUCED)
    cameras, batch = full.cameras, full.cameras["batch"]
    again = fit_filters(frames, replace(initial, camera=batch), matcher)
    return {
        "number": sensor,
        "sensor_id": scenario.sensor_id,
        "settings": _settings(scenario, full),
        "parameters": _parameters(simulation, full, matcher),
        "nees": number(_nees(simulation, full)),
        "gates": _gates({"full": full, "reduced": reduced, "restarted": again}),
        **_evaluations(simulation, full, reduced, matcher),
        "convergence": convergence({"lab": full, "batch": again}, batch),
        "ends": ends(full, again),
        "errors": tail_and_aggregate(frames, again, batch, matcher),
        "radial": radial_difference(cameras | {TRUE: simulation.true.camera}),
        "settling": settling(simulation.validation.frames, full, matcher),
        "paper": published(sensor),
    }


def _settings(scenario: Scenario, full: Fits) -> dict[str, Any]:
    """Return what the numbers depend on."""
    return {
        "noise_sd_px": scenario.sensor.noise.sd_px,
        "simulated_noise_sd_px": scenario.noise.sd_px,
        "process_noise": full.documents["q"]["sequential"]["variant"]["process_noise"],
        "initial_sd_sigma": scenario.sensor.sequential.initial_sd_sigma,
        "calibration_frames": scenario.calibration.frames,
        "validation_frames": scenario.validation.frames,
    }


def _parameters(simulation: Simulation, full: Fits, matcher: Matcher) -> list[dict[str, Any]]:
    """Return one row per parameter: the start, the truth, and what each method makes of it."""
    initial, true = simulation.initial.camera, simulation.true.camera
    rows = []
    for k, name in enumerate(initial.parameter_names):
        fitted = {method: full.documents[method]["parameters"][k] for method in METHODS}
        rows.append(
            {
                "name": name,
                "sigma": matcher.config.camera.scale[name].sigma,
                "initial": number(initial.parameters[k]),
                "true": number(true.parameters[k]),
                "fitted": {method: item["fitted"] for method, item in fitted.items()},
                "sd": {method: item["sd"] for method, item in fitted.items()},
            }
        )
    return rows


def _nees(simulation: Simulation, full: Fits) -> float:
    """Return the batch fit's normalised error squared per parameter: 1 expected."""
    error = full.cameras["batch"].parameters - simulation.true.camera.parameters
    covariance = np.array(full.documents["batch"]["covariance"], dtype=np.float64)
    # The parameters' units lie 24 powers of ten apart.
    sd = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sd, sd)
    return float(error / sd @ np.linalg.solve(correlation, error / sd) / len(error))


def _gates(fits: Mapping[str, Fits]) -> list[dict[str, Any]]:
    """Return every fit with the gates' verdict on it."""
    return [
        {"fit": kind, "method": method, **document["verdict"]}
        for kind, group in fits.items()
        for method, document in group.documents.items()
    ]


def _evaluations(
    simulation: Simulation, full: Fits, reduced: Fits, matcher: Matcher
) -> dict[str, Any]:
    """Return Table IV (calibration data) and Tables V and VI (validation data) of one sensor."""
    initial: Calibration = simulation.initial
    fitted: dict[str, Camera] = {"raw": initial.camera, **full.cameras}
    fitted |= {f"{name}_reduced": camera for name, camera in reduced.cameras.items()}
    fitted |= {TRUE: simulation.true.camera}
    before_and_after = {name: fitted[name] for name in ("raw", "batch")}
    parts = {
        "calibration": (simulation.calibration.frames, before_and_after),
        "validation": (simulation.validation.frames, fitted),
    }
    return {
        name: evaluate(frames, cameras, initial.c_sd, matcher)
        for name, (frames, cameras) in parts.items()
    }
