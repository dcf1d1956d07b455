"""Monte Carlo of the sequential estimators: are innovations and errors what their covariance says?

Simulated sensors with the centroid noise that the configuration assumes, without gross errors and
false stars, from the nominal camera, No-Q, with rematching.  NIS: mean square of the standardised
innovations, 1 expected.  NEES: error^T P^-1 error after a number of frames, 8 expected.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.stats import chi2
from study import ROOT, make_matcher

from stcal.matching import match
from stcal.pipeline.filter_run import run_filter
from stcal.pipeline.filtering import Variant, make_filter
from stcal.pipeline.parameters import parameter_scale
from stcal.simulate import load_scenario, scenario_with, simulate

CLEAN = {
    "noise__sd_px": 0.4,
    "detection__outlier_probability": 0.0,
    "detection__false_stars_per_exposure": 0.0,
}


def one_run(number: int, seed: int, frames: int, method: str, matcher) -> dict:
    """Return NIS and its degrees of freedom over the whole run, and NEES at a few lengths."""
    scenario = load_scenario(ROOT / "configs" / "scenarios" / f"st16-{number}.toml")
    changes = CLEAN | {"calibration__segments__0__frames": frames}
    data = simulate(scenario_with(scenario, **changes), seed)
    baseline = match(data.calibration.frames, data.initial.camera, data.initial.c_sd, matcher)
    chosen = make_filter(Variant(method=method), data.initial, matcher)
    names = data.initial.camera.parameter_names
    truth = data.true.camera.parameters - data.initial.camera.parameters
    truth = truth / parameter_scale(matcher.config, names)
    nees = {}
    for length in sorted({frames // 8, frames // 2, frames}):
        part = baseline.take(np.arange(length))
        run = run_filter(chosen, [part], chosen.start)
        error = run.state.x - truth
        nees[length] = float(error @ np.linalg.solve(chosen.covariance(run.state), error))
    used = run.history.arcs > 0
    return {
        "nis": float(run.history.nis[used].sum()),
        "arcs": int(run.history.arcs.sum()),
        "nees": nees,
        "events": int((run.history.event > 0).sum()),
    }


def study(number: int, runs: int, seed: int, frames: int, method: str, matcher) -> dict:
    found = [one_run(number, seed + k, frames, method, matcher) for k in range(runs)]
    arcs = sum(r["arcs"] for r in found)
    nis = sum(r["nis"] for r in found) / arcs
    bounds = chi2.ppf([0.025, 0.975], arcs) / arcs
    print(
        f"sensor {number}, {method}, {runs} runs of {frames} frames: NIS per arc {nis:.4f} (95 % "
        f"bounds {bounds[0]:.4f}..{bounds[1]:.4f}), events {sum(r['events'] for r in found)}"
    )
    document = {"sensor": number, "method": method, "runs": runs, "nis_per_arc": nis}
    document["nis_bounds"] = bounds.tolist()
    limits = chi2.ppf([0.025, 0.975], 8 * runs) / runs
    for length in found[0]["nees"]:
        mean = float(np.mean([r["nees"][length] for r in found]))
        document[f"nees_{length}"] = mean
        print(
            f"    NEES after {length} frames {mean:.2f} (bounds {limits[0]:.2f}..{limits[1]:.2f})"
        )
    document["nees_bounds"] = limits.tolist()
    return document


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--frames", type=int, default=400)
    parser.add_argument("--seed", type=int, default=2001)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    matcher = make_matcher()
    document = [
        study(number, arguments.runs, arguments.seed, arguments.frames, method, matcher)
        for number in (1, 4)
        for method in ("sqrf", "ukf")
    ]
    if arguments.json:
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(json.dumps(document, indent=1))


if __name__ == "__main__":
    main()
