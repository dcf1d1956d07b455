"""Time the sequential estimators: one update against filterpy's, and whole passes over frames.

An update has 21 decorrelated measurements and 8 states (an exposure of 12 stars), Jacobian given.
Rounds alternate, so that a drifting machine slows all alike; ratios are medians over the rounds.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
from study import ROOT, make_matcher
from timing import alternating_times, available, summary

from stcal.estimators.filter_kernels import sigma_points
from stcal.estimators.sequential import SEQUENTIAL
from stcal.matching import match
from stcal.pipeline.filter_run import filter_fragment
from stcal.pipeline.filtering import Variant, make_filter, process_noise_of
from stcal.simulate import load_scenario, scenario_with, simulate

STATES, MEASUREMENTS, CALLS = 8, 21, 500


def repeated(function):
    """Return a function that calls ``function`` often enough to be timed."""

    def calls():
        for _ in range(CALLS):
            function()

    return calls


def problem():
    rng = np.random.default_rng(1)
    jacobian = rng.normal(size=(MEASUREMENTS, STATES))
    return jacobian, rng.normal(size=MEASUREMENTS), np.full(STATES, 10.0)


def own_updates() -> dict:
    jacobian, y, sd = problem()
    rows = np.column_stack([jacobian, y])
    functions = {}
    innovation, score = np.empty(MEASUREMENTS), np.empty(2)
    for name, estimator in SEQUENTIAL.items():
        root = np.ascontiguousarray(estimator.root(sd))
        start, x = root.copy(), np.zeros(STATES)
        points = np.empty((2 * STATES + 1, STATES))
        sigma_points(x, root, points)
        values = np.ascontiguousarray(jacobian @ points.T - y[:, None])
        for precision, steps in estimator.steps.items():

            def update(steps=steps, root=root, start=start, x=x, values=values):
                root[:] = start
                x[:] = 0.0
                steps.update(rows, values, x, root, innovation, score)

            functions[f"{name} {precision}"] = update
    return functions


def filterpy_ekf():
    from filterpy.kalman import ExtendedKalmanFilter

    jacobian, y, sd = problem()
    peer = ExtendedKalmanFilter(dim_x=STATES, dim_z=MEASUREMENTS)
    peer.R = np.eye(MEASUREMENTS)
    start = np.diag(sd**2)
    z = y[:, None]

    def update():
        peer.P = start.copy()
        peer.x = np.zeros((STATES, 1))
        peer.update(z, lambda x: jacobian, lambda x: jacobian @ x)

    return update


def filterpy_ukf():
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    jacobian, y, sd = problem()
    points = MerweScaledSigmaPoints(STATES, alpha=1.0, beta=2.0, kappa=0.0)
    peer = UnscentedKalmanFilter(
        STATES, MEASUREMENTS, dt=1.0, hx=lambda x: jacobian @ x, fx=lambda x, dt: x, points=points
    )
    peer.R, peer.Q = np.eye(MEASUREMENTS), np.zeros((STATES, STATES))
    start = np.diag(sd**2)

    def update():
        peer.P = start.copy()
        peer.x = np.zeros(STATES)
        peer.predict()
        peer.update(y)

    return update


def updates(rounds: int) -> dict:
    """Time updates; an unscented one is set against filterpy's, with its prediction."""
    peers, missing = available({"filterpy EKF": filterpy_ekf, "filterpy UKF": filterpy_ukf})
    own = own_updates()
    functions = {name: repeated(function) for name, function in (own | peers).items()}
    times = alternating_times(functions, rounds)
    rows = {name: {"us": 1e6 * float(np.median(times[name])) / CALLS} for name in times}
    for name in own:
        peer = "filterpy UKF" if name.startswith("ukf") else "filterpy EKF"
        if peer in times:
            rows[name]["peer"] = peer
            rows[name]["ratio"] = summary(times[peer], times[name])["stcal_over_it"]
    rows |= {name: {"missing": reason} for name, reason in missing.items()}
    print(f"update, {STATES} states, {MEASUREMENTS} measurements:")
    for name, row in rows.items():
        if "missing" in row:
            print(f"  {name:18s} missing: {row['missing']}")
            continue
        against = f"   {row['ratio']:.4f} of {row['peer']}" if "ratio" in row else ""
        print(f"  {name:18s} {row['us']:8.2f} us{against}")
    return rows


def passes(number: int, frames: int) -> dict:
    """Frames per second of whole passes, one thread: sqrf and the others, rematching."""
    matcher = make_matcher()
    scenario = load_scenario(ROOT / "configs" / "scenarios" / f"st16-{number}.toml")
    data = simulate(scenario_with(scenario, calibration__segments__0__frames=frames), 7)
    telemetry, initial = data.calibration.frames, data.initial
    start = time.perf_counter()
    baseline = match(telemetry, initial.camera, initial.c_sd, matcher)
    shadow = time.perf_counter() - start
    count, names = telemetry.n_frames, initial.camera.parameter_names
    noise = process_noise_of(matcher.config, names)
    variants = {
        "sqrf No-Q": Variant(),
        "sqrf Q": Variant(process_noise=noise),
        "sqrf No-Q, single": Variant(precision="single"),
        "sqrf No-Refit": Variant(rematch=False),
        "ekf No-Q": Variant(method="ekf"),
        "ukf No-Q": Variant(method="ukf"),
    }
    print(
        f"\npass over {count} frames of sensor {number} from the nominal camera, "
        f"{telemetry.n_stars / telemetry.n_exposures:.1f} stars an exposure, one thread:"
    )
    found = {}
    for name, variant in variants.items():
        chosen = make_filter(variant, initial, matcher)
        times = []
        for _ in range(3):
            start = time.perf_counter()
            _, history, _ = filter_fragment(chosen, baseline, chosen.start)
            times.append(time.perf_counter() - start)
        seconds = float(np.median(times))
        found[name] = {
            "frames_per_s": count / seconds,
            "with_shadow_frames_per_s": count / (seconds + shadow),
            "linearised_anew": int(history.iterations.sum()),
        }
        print(
            f"  {name:18s} {count / seconds:7.0f} frames/s   with the baseline's matches "
            f"{count / (seconds + shadow):6.0f} frames/s   linearised anew "
            f"{history.iterations.sum()} times"
        )
    return {"sensor": number, "frames": count, "variants": found}


def run(options: argparse.Namespace) -> dict:
    """Measure what ``options`` ask for and return it as one document."""
    return {
        "updates": updates(options.rounds),
        "passes": [passes(number, options.frames) for number in (4, 5)],
    }


def arguments(given: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=3000)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--json", type=Path)
    return parser.parse_args(given)


def main() -> None:
    options = arguments()
    document = run(options)
    if options.json:
        options.json.write_text(json.dumps(document, indent=1))


if __name__ == "__main__":
    main()
