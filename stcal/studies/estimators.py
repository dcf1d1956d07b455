"""Study ``estimators``: every combination of camera, residual and estimator on the same frames.

Accuracy against the bound, time and memory on three simulated sensors; robustness to a bad start
and to false matches on one of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from stcal.constants import URAD
from stcal.execution import OrderedMap, serial
from stcal.pipeline.describe import header
from stcal.pipeline.numbers import number
from stcal.report.document import ESTIMATORS_SCHEMA
from stcal.simulate import Scenario
from stcal.studies.estimators_choice import choice
from stcal.studies.estimators_findings import findings
from stcal.studies.estimators_fits import ESTIMATORS, RESIDUALS
from stcal.studies.estimators_runs import (
    FALSE_SHARES,
    STARTS,
    Accuracy,
    Pair,
    Robustness,
    accuracy_run,
    robustness_run,
)
from stcal.studies.estimators_scene import Scene, make_scene
from stcal.studies.machine import processor_name

# The sensors by their scenario files; the first one is the sensor of the robustness tests.
SCENARIOS = ("st16-4", "wu2019", "zhang2024")
ROBUST = "robustness"
COMBINATIONS: tuple[Pair, ...] = tuple(product(RESIDUALS, ESTIMATORS))
# Fewer frames leave weak parameters open.
_LEAST_FRAMES = 30
# A run that ends well is within so many times the bound's rms error: chance alone takes an
# efficient estimate there in less than one run of a thousand, a wrong minimum is far beyond.
WELL = 3.0


def run_study(
    scenarios: Mapping[str, Scenario],
    runs: int,
    frames: int,
    seed: int,
    mapper: OrderedMap = serial,
    combinations: Sequence[Pair] = COMBINATIONS,
) -> dict[str, Any]:
    """Run the study and return its document, schema ``stcal.study.estimators/1``.

    Parameters
    ----------
    scenarios : the simulated sensors by the names of SCENARIOS
    runs, frames : number of runs, and of frames in each
    seed : seeds ``seed`` to ``seed + runs - 1`` are run
    mapper : ordered map over sensors and runs
    combinations : pairs of residual and estimator
    """
    scenes = {name: make_scene(scenarios[name], frames) for name in SCENARIOS}
    scenes[ROBUST] = make_scene(scenarios[SCENARIOS[0]], max(frames // 2, _LEAST_FRAMES))
    seeds = range(seed, seed + runs)
    # The longest first, so that no worker is left with one at the end.
    work = [(ROBUST, number) for number in seeds]
    work += [(name, number) for name in SCENARIOS for number in seeds]
    one = partial(_one, scenes=scenes, pairs=combinations)
    found: dict[str, list[Any]] = {name: [] for name in scenes}
    for (name, _), result in zip(work, mapper(one, work), strict=True):
        found[name].append(result)
    document = {
        **header(
            ESTIMATORS_SCHEMA, ", ".join(scenes[name].scenario.sensor_id for name in SCENARIOS)
        ),
        "seed": seed,
        "runs": runs,
        "frames": frames,
        "machine": processor_name(),
        "well": WELL,
        "sensors": {name: _sensor(scenes[name], found[name], combinations) for name in SCENARIOS},
        "robustness": _robustness(scenes[ROBUST], found[ROBUST], combinations),
    }
    document |= {"choice": choice(document)}
    return document | {"findings": findings(document)}


def _one(item: tuple[str, int], scenes: Mapping[str, Scene], pairs: Sequence[Pair]) -> Any:
    name, seed = item
    run = robustness_run if name == ROBUST else accuracy_run
    return run(scenes[name], seed, pairs)


def _sensor(scene: Scene, runs: Sequence[Accuracy], pairs: Sequence[Pair]) -> dict[str, Any]:
    """Return what the document says of one sensor."""
    efficient = _rms([run.efficient_over_bound for run in runs])
    return {
        "sensor_id": scene.scenario.sensor_id,
        "camera": scene.config.camera.model,
        "name": scene.config.name,
        "stars": number(float(np.mean([run.stars for run in runs]))),
        "bound_urad": number(_rms([run.bound_rad for run in runs]) / URAD),
        "initial_over_bound": number(_rms([run.initial_over_bound for run in runs])),
        "efficient_over_bound": number(efficient),
        "combinations": [_combination(pair, runs) for pair in pairs],
    }


def _combination(pair: Pair, runs: Sequence[Accuracy]) -> dict[str, Any]:
    """Return one combination's figures over the runs that it has finished."""
    done = [run for run in runs if pair in run.fits]
    fits = [run.fits[pair] for run in done]
    over_bound = _rms([fit.over_bound for fit in fits])
    efficient = _rms([run.efficient_over_bound for run in done])
    standardised = _rms([fit.error_over_sd for fit in fits])
    luck = _rms([run.efficient_over_sd for run in done])
    return {
        "residual": pair[0],
        "estimator": pair[1],
        "refused": len(runs) - len(done),
        "over_bound": number(over_bound),
        "over_efficient": number(over_bound / efficient),
        "error_over_sd": number(standardised),
        "honesty": number(standardised / luck),
        "us_per_frame": number(_median([fit.us_per_frame for fit in fits])),
        "kept_bytes": number(_median([float(fit.kept_bytes) for fit in fits])),
    }


def _robustness(scene: Scene, runs: Sequence[Robustness], pairs: Sequence[Pair]) -> dict[str, Any]:
    return {
        "sensor_id": scene.scenario.sensor_id,
        "camera": scene.config.camera.model,
        "runs": len(runs),
        "frames": scene.scenario.calibration.frames,
        "start_sigma": list(STARTS),
        "false_shares": list(FALSE_SHARES),
        "combinations": [
            {
                "residual": pair[0],
                "estimator": pair[1],
                "starts": _ends([run.starts[pair] for run in runs]),
                "false_matches": _ends([run.false_matches[pair] for run in runs]),
            }
            for pair in pairs
        ],
    }


def _ends(errors: Sequence[Sequence[float]]) -> dict[str, Any]:
    """Return by condition the share of runs that end well, and the median error over the bound.

    ``errors`` are those of each run under each condition, infinite where there is no result.
    """
    table = np.array(errors)
    return {
        "well": [number(share) for share in (table <= WELL).mean(axis=0)],
        "over_bound": [number(value) for value in np.median(table, axis=0)],
        "refused": [int(count) for count in np.isinf(table).sum(axis=0)],
    }


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values else float("nan")


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if values else float("nan")
