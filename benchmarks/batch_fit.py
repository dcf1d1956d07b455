"""Time the batch fit: the estimator against its peers, and the whole command on 400 frames.

The peers fit the same centroids of one simulated scene (15 x 20 deg, 0.2 px noise, a camera off in
focal length, distortion and principal point) in alternating rounds: tetra3rs's calibration,
scipy's least_squares with its numeric Jacobian on our residuals, and a joint Gauss-Newton with the
Schur complement in numpy.
A model's error is the rms of its directions over the detector, the best rotation removed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
from camera_fit_peers import (
    detector_grid,
    model_error_arcsec,
    schur_fit,
    scipy_fit,
    tetra3rs_directions,
    tetra3rs_fit,
)
from scenes import Scene, make_images, nominal_camera, true_camera
from study import ROOT, make_matcher
from timing import alternating_times, available, summary

from stcal.estimators.batch import covariance_from
from stcal.execution import serial
from stcal.matching import match
from stcal.pipeline.fitting import solve, with_estimated
from stcal.pipeline.parameters import parameter_scale
from stcal.residuals import ARCLENGTH, select_stars
from stcal.simulate import load_scenario, scenario_with, simulate

SCENE = Scene("calibration", 0.2, focal_error=3e-3, distortion_px=10.0, centre_px=15.0)
OWN = "stcal"


def own_fit(stars, initial, scale):
    """Return a function from matched stars to the fitted camera, covariance and all."""
    free = np.arange(len(scale))

    def fit():
        bound = [ARCLENGTH.bind(stars, initial)]
        solution = solve(bound, initial, scale, free, serial)
        covariance_from(solution.information)
        return with_estimated(initial, free, solution.parameters)

    return fit


def estimator(exposures: int, rounds: int) -> dict:
    matcher = make_matcher()
    images = make_images(SCENE, exposures, matcher.catalogue, 7)
    initial, true = nominal_camera(), true_camera(SCENE)
    matched = match(images.frames, true, np.eye(3), matcher)
    stars = select_stars(matched, matcher.config.noise, 4)
    scale = parameter_scale(matcher.config, initial.parameter_names)
    fits, missing = available(
        {
            OWN: partial(own_fit, stars, initial, scale),
            "numpy Schur": partial(schur_fit, stars, initial, scale),
            "scipy least_squares": partial(scipy_fit, stars, initial, scale),
            "tetra3rs radial": partial(tetra3rs_fit, images, model="radial"),
            "tetra3rs polynomial": partial(tetra3rs_fit, images, model="polynomial", order=3),
        }
    )
    m, n = detector_grid()
    errors = {}
    for name, fit in list(fits.items()):
        try:
            found = fit()
            directions = (
                tetra3rs_directions(found, m, n)
                if name.startswith("tetra3rs")
                else found.directions(m, n)
            )
            errors[name] = model_error_arcsec(directions, true.directions(m, n))
        except Exception as error:  # named in the table
            missing[name] = f"{type(error).__name__}: {error}"
            del fits[name]
    times = alternating_times(fits, rounds)
    rows = {
        name: summary(seconds, times[OWN]) | {"model_error_arcsec": errors[name]}
        for name, seconds in times.items()
    }
    rows |= {name: {"missing": reason} for name, reason in missing.items()}
    return {"exposures": stars.n_exposures, "stars": len(stars.star), "fits": rows}


def far_start(frames: int, rounds: int) -> dict:
    """The estimator on so many frames of simulated sensor 4, from its initial calibration."""
    scenario = load_scenario(ROOT / "configs" / "scenarios" / "st16-4.toml")
    segment = scenario.calibration.segments[0].model_copy(update={"frames": frames})
    part = scenario.calibration.model_copy(update={"segments": [segment]})
    data, matcher = simulate(scenario_with(scenario, calibration=part), 7), make_matcher()
    matched = match(data.calibration.frames, data.true.camera, data.true.c_sd, matcher)
    stars = select_stars(matched, matcher.config.noise, 4)
    scale = parameter_scale(matcher.config, data.true.camera.parameter_names)
    fit = own_fit(stars, data.initial.camera, scale)
    best = min(alternating_times({OWN: fit}, rounds)[OWN])
    print(
        f"camera fit, {frames} frames ({stars.n_exposures} exposures of "
        f"{len(stars.star) / stars.n_exposures:.1f} stars) from the initial calibration: "
        f"best {best:.3f} s"
    )
    return {"frames": frames, "exposures": stars.n_exposures, "stars": len(stars.star),
            "best_s": best}  # fmt: skip


def report(document: dict) -> None:
    count, stars = document["exposures"], document["stars"]
    print(f"camera fit, {count} exposures, {stars / count:.1f} stars each, one thread:")
    for name, row in document["fits"].items():
        if "missing" in row:
            print(f"  {name:20s} missing: {row['missing']}")
            continue
        print(
            f"  {name:20s} best {row['best_s']:7.3f} s  median {row['median_s']:7.3f} s  "
            f"model error {row['model_error_arcsec']:6.2f} arcsec  "
            f"stcal's time over it {row['stcal_over_it']:.3f}"
        )


def whole_command(rounds: int) -> dict:
    """Wall time of `stcal fit --batch` on the sample's 400 frames of sensor 4, process and all."""
    stcal = [sys.executable, "-m", "stcal"]
    sample, sensor = ROOT / "sample_telemetry", "ST16-4"
    with tempfile.TemporaryDirectory() as folder:
        store = Path(folder) / "store"
        config = ["--config", str(ROOT / "configs" / "st16.toml")]
        source = str(sample / f"{sensor}.calibration.csv.gz")
        subprocess.run(
            [*stcal, "ingest", source, "--store", store, *config], check=True, capture_output=True
        )
        command = [
            *stcal, "fit", "--batch", "--store", store, "--sensor", sensor,
            "--initial", sample / f"{sensor}.initial.json", "--out", Path(folder) / "fit",
            "--json",
        ]  # fmt: skip

        def run():
            return subprocess.run(command, check=True, capture_output=True, text=True).stdout

        document = json.loads(run())
        seconds = alternating_times({"command": run}, rounds)["command"]
    print(
        f"stcal fit --batch, {document['frames']} frames, {len(document['cycles'])} cycles: best "
        f"{min(seconds):.2f} s, median {np.median(seconds):.2f} s wall, report and all"
    )
    return {
        "seconds": float(np.median(seconds)),
        "best_s": min(seconds),
        "frames": document["frames"],
        "cycles": len(document["cycles"]),
    }


def run(options: argparse.Namespace) -> dict:
    """Measure what ``options`` ask for and return it as one document."""
    fits = estimator(options.exposures, options.rounds)
    report(fits)
    far = far_start(options.frames, options.rounds)
    command = {"missing": "left out"} if options.no_command else whole_command(options.rounds)
    return {"estimator": fits, "far_start": far, "command": command}


def arguments(given: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--exposures", type=int, default=1000)
    parser.add_argument("--frames", type=int, default=1000, help="of the fit from far off")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--no-command", action="store_true", help="leave the whole command out")
    parser.add_argument("--json", type=Path)
    return parser.parse_args(given)


def main() -> None:
    options = arguments()
    document = run(options)
    if options.json:
        options.json.write_text(json.dumps(document, indent=1))


if __name__ == "__main__":
    main()
