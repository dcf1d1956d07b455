"""Lost-in-space and guided identification against tetra3rs, one thread, in the same run."""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
from scenes import COLS, FOCAL_M, PIXEL_M, ROWS, SCENES, Images, make_images, nominal_camera

from stcal.catalog.catalogue import load_bundled, select
from stcal.config import load_config
from stcal.frames import MatchedFrames
from stcal.matching import Matcher, match

# An attitude further off than this from the truth is a wrong solution, not a bad camera's.
WRONG_RAD = np.radians(0.5)


def angles(c: np.ndarray, truth: np.ndarray) -> np.ndarray:
    trace = np.einsum("eij,eij->e", c, truth)
    return np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))


def run_stcal(
    images: Images, matcher: Matcher, method: str, hints: np.ndarray | None
) -> tuple[MatchedFrames, dict]:
    frames = images.frames
    arguments = (frames, nominal_camera(), np.eye(3), matcher, method, hints)
    match(*arguments)
    times = []
    for _ in range(5):
        start = time.perf_counter()
        matched = match(*arguments)
        times.append(time.perf_counter() - start)
    us = 1e6 * float(np.median(times)) / frames.n_frames
    return matched, score(matched, images) | {"us": us}


def score(matched: MatchedFrames, images: Images) -> dict:
    solved = matched.solved[0::2]
    off = angles(matched.c_di[0::2][solved], images.c_di[solved])
    found = matched.star >= 0
    return {
        "solved": float(solved.mean()),
        "wrong": int((off > WRONG_RAD).sum()),
        "matched": int(found.sum()),
        "false_matches": int((found & (matched.star != images.truth)).sum()),
    }


def disagreements(lost: MatchedFrames, guided: MatchedFrames) -> np.ndarray:
    """Return the exposures (one a frame here) in which the two methods differ in any star."""
    frames = lost.frames
    differing = np.bincount(
        frames.exposure_of_star, lost.star != guided.star, minlength=frames.n_exposures
    )
    return np.flatnonzero((differing > 0) | (lost.solved != guided.solved)) // 2


def hints_near(images: Images, seed: int) -> np.ndarray:
    """Return the true attitudes turned by 0.05 deg, as a tracker's previous solution would be."""
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec(rng.normal(0.0, np.radians(0.05), (len(images.c_di), 3)))
    hints = np.full((2 * len(images.c_di), 3, 3), np.nan)
    hints[0::2] = turn.as_matrix() @ images.c_di
    return hints


def make_peer():
    try:
        import tetra3rs
    except ImportError:
        print("tetra3rs is not installed: pip install '.[bench]'")
        return None
    return tetra3rs.SolverDatabase.generate_from_gaia(
        max_fov_deg=21.0, min_fov_deg=15.0, star_max_magnitude=6.3, epoch_proper_motion_year=2025
    )


def run_peer(database, images: Images) -> dict:
    frames, fov = images.frames, float(np.degrees(2 * np.arctan(COLS / 2 * PIXEL_M / FOCAL_M)))
    lists = []
    for e in range(frames.n_frames):
        part = slice(frames.star_offsets[2 * e], frames.star_offsets[2 * e + 1])
        # Origin at the centre, x right, y down; our rows count upwards.
        x, y = frames.col_px[part] - (COLS - 1) / 2, (ROWS - 1) / 2 - frames.row_px[part]
        lists.append(np.ascontiguousarray(np.stack([x, y, frames.intensity[part]], axis=1)))
    settings = {"fov_estimate_deg": fov, "image_shape": (ROWS, COLS), "fov_max_error_deg": 0.5}
    results = [database.solve_from_centroids(c, **settings) for c in lists]
    times = []
    for _ in range(3):
        one = []
        for c in lists:
            start = time.perf_counter()
            database.solve_from_centroids(c, **settings)
            one.append(time.perf_counter() - start)
        times.append(one)
    solved = np.array([hasattr(r, "ra_deg") for r in results])
    wrong = 0
    for e in np.flatnonzero(solved):
        ra, dec = np.radians(results[e].ra_deg), np.radians(results[e].dec_deg)
        axis = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
        wrong += bool(axis @ images.c_di[e, 2] < np.cos(WRONG_RAD))
    return {
        "solved": float(solved.mean()),
        "wrong": int(wrong),
        "us": 1e6 * float(np.mean(np.median(times, axis=0))),
        "us_median": 1e6 * float(np.median(times)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--exposures", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=20)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    config = load_config(Path(__file__).parents[1] / "configs" / "st16.toml")
    section = config.catalogue
    catalogue = select(load_bundled(), section.limiting_magnitude, section.merge_separation_arcsec)
    matcher, peer, rows = Matcher(catalogue, config), make_peer(), []
    for k, scene in enumerate(SCENES):
        images = make_images(scene, arguments.exposures, catalogue, arguments.seed + k)
        lost_matched, lost = run_stcal(images, matcher, "lost-in-space", None)
        guided_matched, guided = run_stcal(images, matcher, "guided", hints_near(images, k))
        differ = disagreements(lost_matched, guided_matched)
        agree = 1.0 - len(differ) / arguments.exposures
        row = {"scene": scene.name, "lost": lost, "guided": guided, "agreement": agree}
        line = (
            f"{scene.name:52s} stars {images.frames.n_stars / arguments.exposures:5.1f}  "
            f"lost {lost['us']:6.1f} us {lost['solved']:.4f} wrong {lost['wrong']} "
            f"false {lost['false_matches']}/{lost['matched']}  "
            f"guided {guided['us']:6.1f} us {guided['solved']:.4f} wrong {guided['wrong']}"
        )
        if peer is not None:
            row["tetra3rs"] = run_peer(peer, images)
            row["ratio_lost"] = lost["us"] / row["tetra3rs"]["us_median"]
            line += (
                f"  tetra3rs {row['tetra3rs']['us_median']:6.1f} us "
                f"{row['tetra3rs']['solved']:.4f} wrong {row['tetra3rs']['wrong']}"
                f"  ratio {row['ratio_lost']:.2f}"
            )
        rows.append(row)
        print(line, flush=True)
        print(f"{'':52s} the methods agree on every star in {agree:.2%} of exposures", end="")
        print(f"; not in exposures {differ.tolist()}" if len(differ) else "", flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
