"""Monte Carlo study of the batch fit on simulated sensors: does it reach the noise, and know it?

1. The six sensors of Table III: held-out RMS against the RMS with the true parameters,
   availability, matched star ratio, attitude continuity.
2. Many runs of one sensor: rms(error / sd) of every parameter, NEES, and sd against the
   Cramer-Rao bound of the joint problem (parameters and all attitudes, centroid noise in pixels).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from stcal.attitude import mean_rotation
from stcal.cameras import Camera
from stcal.catalog.catalogue import load_bundled, select
from stcal.config import load_config
from stcal.matching import Matcher, match
from stcal.pipeline.fit import fit_batch
from stcal.pipeline.parameters import parameter_scale
from stcal.pipeline.validate import compare
from stcal.residuals import select_stars
from stcal.simulate import Simulation, load_scenario, simulate

ROOT = Path(__file__).parents[1]


def make_matcher() -> Matcher:
    config = load_config(ROOT / "configs" / "st16.toml")
    section = config.catalogue
    return Matcher(
        select(load_bundled(), section.limiting_magnitude, section.merge_separation_arcsec), config
    )


def cramer_rao_sd(data: Simulation, matcher: Matcher) -> np.ndarray:
    """Bound (P,) on the sd of the parameters, from the pixel measurement model itself.

    Each star's centroid is a function of the camera and its exposure's attitude; the attitude is
    projected out exposure by exposure.  Independent of arclengths and their covariance.
    """
    camera, part = data.true.camera, data.calibration
    matched = match(part.frames, camera, data.true.c_sd, matcher)
    stars = select_stars(matched, matcher.config.noise, 4)
    real = np.isfinite(part.truth.sd_px[stars.star]) & ~part.truth.outlier[stars.star]
    stars = stars.keep(real, 4)
    scale = parameter_scale(matcher.config, camera.parameter_names)
    by_parameter, by_attitude = pixel_jacobians(camera, stars.row_px, stars.col_px)
    sd = part.truth.sd_px[stars.star][:, None, None]
    by_parameter, by_attitude = by_parameter * scale / sd, by_attitude / sd
    information = np.zeros((len(scale), len(scale)))
    for first, last in zip(stars.offsets[:-1], stars.offsets[1:], strict=True):
        J = by_parameter[first:last].reshape(-1, len(scale))
        A, _ = np.linalg.qr(by_attitude[first:last].reshape(-1, 3))
        J = J - A @ (A.T @ J)
        information += J.T @ J
    return np.sqrt(np.diag(np.linalg.inv(information))) * scale


def pixel_jacobians(camera: Camera, m: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """d(m, n)/dx (S, 2, P) and d(m, n)/d(attitude) (S, 2, 3), by the implicit function theorem."""
    s, by_parameter, by_pixel = camera.jacobian(m, n)
    inverse = np.linalg.pinv(by_pixel)
    turned = np.zeros((len(s), 3, 3))
    for axis in range(3):
        turned[:, :, axis] = np.cross(np.eye(3)[axis], s)
    return -inverse @ by_parameter, inverse @ turned


def one_fit(number: int, seed: int, matcher: Matcher):
    scenario = load_scenario(ROOT / "configs" / "scenarios" / f"st16-{number}.toml")
    data = simulate(scenario, seed)
    return data, fit_batch([data.calibration.frames], data.initial, matcher, {"parent_sha256": ""})


def six_sensors(seed: int, matcher: Matcher) -> list[dict]:
    print(f"Six simulated sensors, seed {seed} (validation part):")
    print("sensor  avail. initial final   MSR   RMS initial  final   true  ratio  offset/spread")
    rows = []
    for number in range(1, 7):
        data, result = one_fit(number, seed, matcher)
        if not result.accepted:
            print(f"{number}  refused: {result.document['verdict']['reasons']}")
            rows.append({"sensor": number, "refused": result.document["verdict"]["reasons"]})
            continue
        frames, fitted = data.validation.frames, result.calibration
        change = compare([frames], data.initial, fitted, matcher)
        truth = compare([frames], data.true, fitted, matcher)
        turn = mean_rotation(change.turns)
        from stcal.geometry.rotations import vector_from_matrix

        offset = np.abs(vector_from_matrix(turn.c[None])[0] / turn.spread).max()
        counted = change.counted.sum()
        row = {
            "sensor": number,
            "availability_initial": float(change.fixed[0].sum() / counted),
            "availability_final": float(change.fixed[1].sum() / counted),
            "matched_star_ratio": float(change.stars[1].sum() / change.stars[0].sum()),
            "rms_initial_urad": change.sums[0].rms_rad * 1e6,
            "rms_final_urad": truth.sums[1].rms_rad * 1e6,
            "rms_true_urad": truth.sums[0].rms_rad * 1e6,
            "ratio": truth.sums[1].rms_rad / truth.sums[0].rms_rad,
            "attitude_offset_over_spread": float(offset),
        }
        rows.append(row)
        print(
            f"{number:6d}  {row['availability_initial']:14.3f} {row['availability_final']:5.3f} "
            f"{row['matched_star_ratio']:5.2f} {row['rms_initial_urad']:13.1f} "
            f"{row['rms_final_urad']:6.1f} {row['rms_true_urad']:6.1f} {row['ratio']:6.4f} "
            f"{row['attitude_offset_over_spread']:14.2f}",
            flush=True,
        )
    return rows


def consistency(number: int, runs: int, seed: int, matcher: Matcher) -> dict:
    scores, nees, ratios, names = [], [], [], ()
    for run in range(runs):
        data, result = one_fit(number, seed + run, matcher)
        if not result.accepted:
            print(f"run {run}: refused: {result.document['verdict']['reasons']}")
            continue
        found = result.calibration
        names = found.camera.parameter_names
        error = found.camera.parameters - data.true.camera.parameters
        sd = np.sqrt(np.diag(found.covariance))
        scores.append(error / sd)
        nees.append(error @ np.linalg.solve(found.covariance, error))
        ratios.append(sd / cramer_rao_sd(data, matcher))
    scores, ratios = np.array(scores), np.array(ratios)
    each = np.sqrt((scores**2).mean(axis=0))
    overall = float(np.sqrt((scores**2).mean()))
    degrees = scores.size
    bounds = chi2.ppf([0.025, 0.975], degrees) / len(scores)
    print(f"\nSensor {number}, {len(scores)} runs, seeds {seed}..{seed + runs - 1}:")
    for k, name in enumerate(names):
        print(
            f"  {name:10s} rms(error/sd) {each[k]:.3f}   mean(error/sd) {scores[:, k].mean():+.2f}"
            f"   sd / Cramer-Rao bound {ratios[:, k].mean():.4f}"
        )
    print(
        f"  all        rms(error/sd) {overall:.3f}   mean NEES {np.mean(nees):.2f} "
        f"(95 % bounds {bounds[0]:.2f}..{bounds[1]:.2f})   sd / bound {ratios.min():.4f}.."
        f"{ratios.max():.4f}"
    )
    return {
        "sensor": number,
        "runs": len(scores),
        "rms_error_over_sd": dict(zip(names, each.tolist(), strict=True)),
        "rms_error_over_sd_all": overall,
        "mean_nees": float(np.mean(nees)),
        "nees_bounds": bounds.tolist(),
        "sd_over_bound": dict(zip(names, ratios.mean(axis=0).tolist(), strict=True)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1001)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    matcher = make_matcher()
    document = {"six_sensors": six_sensors(arguments.seed, matcher), "consistency": []}
    for number in (2, 4, 5):
        document["consistency"].append(consistency(number, arguments.runs, arguments.seed, matcher))
    if arguments.json:
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(json.dumps(document, indent=1))


if __name__ == "__main__":
    main()
