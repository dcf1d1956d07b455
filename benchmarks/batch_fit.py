"""Time the batch fit: from matched stars of 1000 frames, and the whole command on 400 frames.

The peer for the estimator is scipy's least_squares with its numeric Jacobian on the same residuals.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from study import ROOT, make_matcher

from stcal.execution import serial
from stcal.matching import match
from stcal.pipeline.cycles import solve
from stcal.pipeline.parameters import parameter_scale
from stcal.residuals import bind_arclength, select_stars
from stcal.simulate import load_scenario, scenario_with, simulate


def median_time(function, runs: int) -> tuple[float, object]:
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        value = function()
        times.append(time.perf_counter() - start)
    return float(np.median(times)), value


def estimator(frames_wanted: int) -> dict:
    matcher = make_matcher()
    scenario = load_scenario(ROOT / "configs" / "scenarios" / "st16-4.toml")
    changes = {
        "calibration__segments__0__frames": frames_wanted,
        "detection__limiting_magnitude": 5.7,
    }
    data = simulate(scenario_with(scenario, **changes), 3)
    frames, initial = data.calibration.frames, data.initial
    matched = match(frames, data.true.camera, data.true.c_sd, matcher)
    stars = select_stars(matched, matcher.config.noise, 4)
    scale = parameter_scale(matcher.config, initial.camera.parameter_names)

    def ours():
        bound = [bind_arclength(stars, initial.camera)]
        return bound, solve(bound, initial.camera, scale, np.arange(8), serial)

    ours()
    own_time, (bound, solution) = median_time(ours, 5)

    def residuals(z):
        camera = initial.camera.with_parameters(initial.camera.parameters + z * scale)
        return bound[0].linearise(camera)[:, -1]

    peer_time, peer = median_time(lambda: least_squares(residuals, np.zeros(8), method="lm"), 1)
    print(
        f"batch fit, {frames.n_frames} frames, {len(stars.star) / stars.n_exposures:.1f} stars an "
        f"exposure, {len(stars.star)} stars: stcal {own_time:.3f} s, scipy least_squares "
        f"(numeric Jacobian) {peer_time:.3f} s, ratio {own_time / peer_time:.3f}; chi2 "
        f"{solution.chi2:.3f} against {2 * peer.cost:.3f}"
    )
    return {"stcal_s": own_time, "scipy_s": peer_time, "ratio": own_time / peer_time}


def whole_command() -> dict:
    """Wall time of `stcal fit --batch` on the sample's 400 frames of sensor 4, process and all."""
    stcal = Path(sys.executable).with_name("stcal")
    sample, sensor = ROOT / "sample_telemetry", "ST16-4"
    with tempfile.TemporaryDirectory() as folder:
        store = Path(folder) / "store"
        config = ["--config", str(ROOT / "configs" / "st16.toml")]
        source = str(sample / f"{sensor}.calibration.csv.gz")
        subprocess.run(
            [stcal, "ingest", source, "--store", store, *config], check=True, capture_output=True
        )
        command = [
            stcal, "fit", "--batch", "--store", store, "--sensor", sensor,
            "--initial", sample / f"{sensor}.initial.json", "--out", Path(folder) / "fit",
            "--json",
        ]  # fmt: skip

        def run():
            return subprocess.run(command, check=True, capture_output=True, text=True).stdout

        run()
        seconds, output = median_time(run, 5)
    document = json.loads(output)
    print(
        f"stcal fit --batch, {document['frames']} frames, {len(document['cycles'])} cycles: "
        f"{seconds:.2f} s wall, report and all"
    )
    return {"seconds": seconds, "frames": document["frames"], "cycles": len(document["cycles"])}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    document = {"estimator": estimator(arguments.frames), "command": whole_command()}
    if arguments.json:
        arguments.json.write_text(json.dumps(document, indent=1))


if __name__ == "__main__":
    main()
