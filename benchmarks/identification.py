"""Lost-in-space and guided identification against tetra3rs, one thread, in the same run."""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
from scenes import COLS, FOCAL_M, PIXEL_M, ROWS, SCENES, Images, Scene, make_images, nominal_camera

from stcal.catalog.catalogue import load_bundled, select
from stcal.config import load_config
from stcal.frames import MatchedFrames
from stcal.matching import Matcher, match

# An attitude further off than this from the truth is a wrong solution, not a bad camera's.
WRONG_RAD = np.radians(0.5)


def angles(c: np.ndarray, truth: np.ndarray) -> np.ndarray:
    trace = np.einsum("eij,eij->e", c, truth)
    return np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))


ROUNDS = 7


def identification(images: Images, matcher: Matcher, method: str, hints: np.ndarray | None):
    """Return a function that identifies all exposures and returns the matched frames."""
    arguments = (images.frames, nominal_camera(), np.eye(3), matcher, method, hints)
    return lambda: match(*arguments)


def paired_times(functions: dict) -> dict:
    """Time functions in turn, A B C A B C ..., and return the seconds of each round by name.

    Pairing keeps ratios meaningful while the machine's speed drifts.
    """
    for function in functions.values():
        function()
    times = {name: [] for name in functions}
    for _ in range(ROUNDS):
        for name, function in functions.items():
            start = time.perf_counter()
            function()
            times[name].append(time.perf_counter() - start)
    return {name: np.array(values) for name, values in times.items()}


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


def peer_solver(database, images: Images):
    """Return a function that solves all exposures with the peer and returns its results."""
    frames, fov = images.frames, float(np.degrees(2 * np.arctan(COLS / 2 * PIXEL_M / FOCAL_M)))
    lists = []
    for e in range(frames.n_frames):
        part = slice(frames.star_offsets[2 * e], frames.star_offsets[2 * e + 1])
        # Origin at the centre, x right, y down; our rows count upwards.
        x, y = frames.col_px[part] - (COLS - 1) / 2, (ROWS - 1) / 2 - frames.row_px[part]
        lists.append(np.ascontiguousarray(np.stack([x, y, frames.intensity[part]], axis=1)))
    settings = {"fov_estimate_deg": fov, "image_shape": (ROWS, COLS), "fov_max_error_deg": 0.5}
    return lambda: [database.solve_from_centroids(c, **settings) for c in lists]


def score_peer(results: list, images: Images) -> dict:
    solved = np.array([hasattr(r, "ra_deg") for r in results])
    wrong = 0
    for e in np.flatnonzero(solved):
        ra, dec = np.radians(results[e].ra_deg), np.radians(results[e].dec_deg)
        axis = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
        wrong += bool(axis @ images.c_di[e, 2] < np.cos(WRONG_RAD))
    return {"solved": float(solved.mean()), "wrong": int(wrong)}


def run_scene(scene: Scene, images: Images, matcher: Matcher, peer, seed: int) -> dict:
    lost = identification(images, matcher, "lost-in-space", None)
    guided = identification(images, matcher, "guided", hints_near(images, seed))
    functions = {"lost": lost, "guided": guided}
    if peer is not None:
        functions["tetra3rs"] = peer_solver(peer, images)
    times = paired_times(functions)
    matched = {"lost": lost(), "guided": guided()}
    count = images.frames.n_frames
    row = {"scene": scene.name, "stars": images.frames.n_stars / count}
    for name, found in matched.items():
        row[name] = score(found, images) | {"us": 1e6 * float(np.median(times[name])) / count}
    row["differ"] = disagreements(matched["lost"], matched["guided"]).tolist()
    if peer is not None:
        us = 1e6 * float(np.median(times["tetra3rs"])) / count
        row["tetra3rs"] = score_peer(functions["tetra3rs"](), images) | {"us": us}
        for name in matched:
            row[f"ratio_{name}"] = float(np.median(times[name] / times["tetra3rs"]))
    return row


def report(row: dict, exposures: int) -> None:
    print(f"{row['scene']} ({row['stars']:.1f} stars)")
    for name in ("lost", "guided", "tetra3rs"):
        if name not in row:
            continue
        one = row[name]
        line = f"  {name:9s} {one['us']:6.1f} us  solved {one['solved']:.4f}  wrong {one['wrong']}"
        if "matched" in one:
            line += f"  false matches {one['false_matches']} of {one['matched']}"
        if f"ratio_{name}" in row:
            line += f"  time over tetra3rs's {row[f'ratio_{name}']:.2f}"
        print(line)
    share = 1.0 - len(row["differ"]) / exposures
    where = f"; not in exposures {row['differ']}" if row["differ"] else ""
    print(f"  both methods agree on every star in {share:.2%} of exposures{where}", flush=True)


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
        rows.append(run_scene(scene, images, matcher, peer, k))
        report(rows[-1], arguments.exposures)
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
