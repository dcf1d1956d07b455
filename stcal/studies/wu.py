"""Study ``wu``: the simulations of Wu et al. 2019, section 4.1, many times over.

A run is what the paper did once: 2400 images to calibrate with from poor initial values, 100 to
judge by.  Beside each accuracy stands what the data allow: a single run's is a matter of luck.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.config import SensorConfig
from stcal.errors import UsageError
from stcal.execution import OrderedMap, serial
from stcal.pipeline.describe import header
from stcal.pipeline.numbers import number, numbers
from stcal.report.document import WU_SCHEMA
from stcal.studies.machine import processor_name
from stcal.studies.wu_comparison import comparison
from stcal.studies.wu_convergence import Observability, observability
from stcal.studies.wu_findings import findings
from stcal.studies.wu_paper import EVALUATION_IMAGES, GROUP, GROUPS, IMAGES, MODEL, published
from stcal.studies.wu_runs import Criterion, GroupRun, Outcome, run_groups
from stcal.studies.wu_scene import LIMITS, SENSOR_ID, Scene, make_scene

Floats = NDArray[np.float64]

# Fewer images to calibrate with leave weak parameters open.
_LEAST_IMAGES = 100
# Images that Figures 3 and 4 show.
_OBSERVED = 200


def run_study(
    config: SensorConfig,
    runs: int,
    seed: int,
    mapper: OrderedMap = serial,
    images: int = IMAGES,
) -> dict[str, Any]:
    """Run the study and return its document, schema ``stcal.study.wu/1``.

    Parameters
    ----------
    config : the sensor; its nominal camera is the true one
    runs : how often, each with other images and other noise
    seed : the same seed gives the same numbers, times excepted
    mapper : ordered map over the runs
    images : number of images of a run, the last 100 of which judge

    Raises
    ------
    ConfigError
        When the sensor's camera model isn't the paper's.
    UsageError
        When there are too few images.
    """
    least = _LEAST_IMAGES + EVALUATION_IMAGES
    if images < least:
        raise UsageError(f"{images} images: the last {EVALUATION_IMAGES} judge; give {least}")
    scene = make_scene(config, images - EVALUATION_IMAGES, EVALUATION_IMAGES)
    one = partial(_one, scene=scene, seed=seed)
    found = list(mapper(one, range(runs)))
    groups = {str(group): _group(scene, [run[group] for run in found]) for group in GROUPS}
    observed = observability(scene, found[0][GROUP].calibration.known)
    document = {
        **header(WU_SCHEMA, SENSOR_ID),
        "seed": seed,
        "runs": runs,
        "settings": _settings(scene),
        "groups": groups,
        "observability": _observability(observed),
        "paper": published(),
    }
    document |= {"comparison": comparison(document)}
    return document | {"findings": findings(document)}


def _one(run: int, scene: Scene, seed: int) -> dict[int, GroupRun]:
    return run_groups(scene, seed, run)


def _settings(scene: Scene) -> dict[str, Any]:
    """Return what the numbers depend on."""
    names = scene.true.parameter_names
    sigma = scene.config.sequential.initial_sd_sigma
    columns = {
        "true": scene.true.parameters,
        "initial": scene.initial.camera.parameters,
        "prior_sd": sigma * scene.scale,
    }
    return {
        "rows": scene.true.rows,
        "cols": scene.true.cols,
        "noise_sd_px": scene.config.noise.sd_px,
        "calibration_images": scene.calibration,
        "evaluation_images": scene.evaluation,
        "limiting_magnitudes": {str(group): limit for group, limit in LIMITS.items()},
        "parameters": {
            key: dict(zip(names, numbers(values), strict=True)) for key, values in columns.items()
        },
        "machine": processor_name(),
    }


def _group(scene: Scene, runs: Sequence[GroupRun]) -> dict[str, Any]:
    """Return what the document says of one group; lists are run by run."""
    methods = {name: [run.methods[name] for run in runs] for name in runs[0].methods}
    stars = np.mean([run.stars for run in runs], axis=0)
    return {
        "stars": number(stars[0]),
        "stars_at_paper_magnitude": number(stars[1]),
        "bound": _distribution(np.concatenate([run.bound for run in runs])),
        "efficient": _criterion([run.efficient for run in runs]),
        "methods": {name: _method(scene, outcomes) for name, outcomes in methods.items()},
        "convergence": _convergence(runs),
    }


def _method(scene: Scene, runs: Sequence[Outcome]) -> dict[str, Any]:
    nominal = np.abs(scene.true.parameters)
    errors = 100.0 * np.array([run.error for run in runs]) / nominal
    return {
        "a": _criterion([run.a for run in runs]),
        "b": _criterion([run.b for run in runs]),
        "constant_r": _criterion([run.constant_r for run in runs]),
        "expected": _distribution(np.concatenate([run.expected for run in runs])),
        "error_percent": {
            name: numbers(errors[:, k]) for k, name in enumerate(scene.true.parameter_names)
        },
        "us_per_image": number(float(np.median([run.us_per_image for run in runs]))),
        "us_settled": number(float(np.median([run.us_settled for run in runs]))),
    }


def _criterion(found: Sequence[Criterion]) -> dict[str, list[Any]]:
    return {
        "mean": numbers([criterion.mean for criterion in found]),
        "sd": numbers([criterion.sd for criterion in found]),
    }


def _distribution(draws: Floats) -> dict[str, Any]:
    """Return the expectation of criterion A in a run, and percentiles over runs."""
    return {"mean": number(draws.mean()), "percentiles": numbers(np.percentile(draws, _PERCENT))}


_PERCENT = np.arange(0.0, 100.5, 1.0)


def _convergence(runs: Sequence[GroupRun]) -> dict[str, Any]:
    """Return Figure 6: root mean square over the runs."""
    found = [run.convergence for run in runs]

    def over_runs(columns: Sequence[Floats]) -> list[Any]:
        squares = np.array(columns) ** 2
        known = np.isfinite(squares)
        with np.errstate(invalid="ignore"):
            return numbers(np.sqrt(np.nansum(squares, axis=0) / known.sum(axis=0)))

    first = found[0]
    return {
        "image": first.image.tolist(),
        "a": {name: over_runs([c.a[name] for c in found]) for name in first.a},
        "b": {name: over_runs([c.b[name] for c in found]) for name in first.b},
        "bound": over_runs([c.bound for c in found]),
    }


def _observability(found: Observability) -> dict[str, Any]:
    """Return Figures 3 and 4 of the first images, and shares of all images of the first run."""
    best, best_outward = (_shares(columns, np.argmax) for columns in (found.models, found.outward))
    shown = slice(0, _OBSERVED)
    return {
        "images": len(found.models[MODEL]),
        "models": {str(k): numbers(v[shown]) for k, v in found.models.items()},
        "values": {str(k): numbers(v[shown]) for k, v in found.values.items()},
        "best_model": best,
        "best_model_outward": best_outward,
        "worst_value": _shares(found.values, np.argmin),
    }


def _shares(columns: Mapping[int, Floats], extreme: Callable[..., Any]) -> dict[str, float]:
    """Return in what share of the images each column is the extreme one."""
    found = extreme(np.array(list(columns.values())), axis=0)
    return {str(key): float((found == place).mean()) for place, key in enumerate(columns)}
