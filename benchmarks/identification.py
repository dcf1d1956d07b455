"""Lost-in-space and guided identification against tetra3rs and cedar-solve, one thread, in one run.

tetra3rs is timed lost in space and in its tracking mode (which falls back to lost in space, as
ours does), on the hints that guided identification gets.  cedar-solve (module ``tetra3``) has no
such mode; it takes milliseconds, so it is given the first exposures only.  A peer that is missing
or fails is named with the reason.
"""

from __future__ import annotations

import argparse
import json
import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scenes import COLS, FOCAL_M, PIXEL_M, ROWS, SCENES, Images, Scene, make_images, nominal_camera

from stcal.catalog.catalogue import load_bundled, select
from stcal.config import load_config
from stcal.frames import MatchedFrames
from stcal.matching import Matcher, match

# An attitude further off than this from the truth is a wrong solution, not a bad camera's.
WRONG_RAD = np.radians(0.5)
# How far a hint is off the truth, an axis; the peer searches three times as far.
HINT_SD_DEG = 0.05
FOV_DEG = float(np.degrees(2 * np.arctan(COLS / 2 * PIXEL_M / FOCAL_M)))
ROUNDS = 7


@dataclass(frozen=True)
class Options:
    """What to measure: exposures a scene, how many of them cedar-solve gets, the random seed."""

    exposures: int = 1000
    cedar_exposures: int = 100
    seed: int = 20


def angles(c: np.ndarray, truth: np.ndarray) -> np.ndarray:
    trace = np.einsum("eij,eij->e", c, truth)
    return np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))


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
    """Return the true attitudes turned a little, as a tracker's previous solution would be."""
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec(rng.normal(0.0, np.radians(HINT_SD_DEG), (len(images.c_di), 3)))
    hints = np.full((2 * len(images.c_di), 3, 3), np.nan)
    hints[0::2] = turn.as_matrix() @ images.c_di
    return hints


@dataclass(frozen=True)
class Peer:
    """A peer: its own mode beside ours, and how it solves the first exposures of a scene."""

    name: str
    beside: str
    exposures: int
    prepare: Callable[[Images, np.ndarray], Callable[[], list[Any]]]
    boresight: Callable[[Any], np.ndarray | None]


def make_peers(options: Options) -> tuple[list[Peer], dict[str, str]]:
    """Return the peers that can be had, and for each of the others the reason."""
    makers = {"tetra3rs": make_tetra3rs, "cedar-solve": make_cedar}
    peers, missing = [], {}
    for name, make in makers.items():
        try:
            peers += make(options)
        except Exception as error:  # whatever a peer raises is worth a line, not the run
            missing[name] = f"{type(error).__name__}: {error}"
    return peers, missing


def centroids(images: Images, exposures: int) -> list[np.ndarray]:
    """Return (N, 3) column, row and intensity of each exposure, brightest first."""
    frames, lists = images.frames, []
    for e in range(exposures):
        part = slice(frames.star_offsets[2 * e], frames.star_offsets[2 * e + 1])
        columns = (frames.col_px[part], frames.row_px[part], frames.intensity[part])
        bright = np.argsort(-frames.intensity[part], kind="stable")
        lists.append(np.ascontiguousarray(np.stack(columns, axis=1)[bright]))
    return lists


def towards(ra_deg: float, dec_deg: float) -> np.ndarray:
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    return np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])


def make_tetra3rs(options: Options) -> list[Peer]:
    import tetra3rs

    database = tetra3rs.SolverDatabase.generate_from_gaia(
        max_fov_deg=21.0, min_fov_deg=15.0, star_max_magnitude=6.3, epoch_proper_motion_year=2025
    )
    settings = {"fov_estimate_deg": FOV_DEG, "image_shape": (ROWS, COLS), "fov_max_error_deg": 0.5}

    def prepare(images: Images, hints: np.ndarray | None) -> Callable[[], list[Any]]:
        # Origin at the centre, x right, y down; our rows count upwards.
        centre, turn = np.array([(COLS - 1) / 2, (ROWS - 1) / 2, 0.0]), np.array([1.0, -1.0, 1.0])
        lists = [(c - centre) * turn for c in centroids(images, options.exposures)]
        if hints is None:
            return lambda: [database.solve_from_centroids(c, **settings) for c in lists]
        # Its camera frame is (column, -row, boresight).
        axes = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        near = [axes @ c for c in hints[0::2]]
        return lambda: [
            database.solve_from_centroids(
                c, attitude_hint=hint, hint_uncertainty_deg=3 * HINT_SD_DEG, **settings
            )
            for c, hint in zip(lists, near, strict=True)
        ]

    def boresight(result: Any) -> np.ndarray | None:
        return towards(result.ra_deg, result.dec_deg) if result else None

    return [
        Peer("tetra3rs", "lost", options.exposures, lambda i, _: prepare(i, None), boresight),
        Peer("tetra3rs tracking", "guided", options.exposures, prepare, boresight),
    ]


def make_cedar(options: Options) -> list[Peer]:
    import tetra3

    logging.getLogger("tetra3.Tetra3").setLevel(logging.WARNING)
    if not hasattr(np, "math"):
        # Version 0.5.1 asks for a name that numpy 2 took away.
        np.math = math
    solver = tetra3.Tetra3(load_database="default_database")
    count = min(options.cedar_exposures, options.exposures)

    def prepare(images: Images, _: np.ndarray) -> Callable[[], list[Any]]:
        # (y, x) from the top left corner, y down.
        corner = np.array([ROWS - 0.5, 0.5])
        lists = [corner + c[:, 1::-1] * [-1.0, 1.0] for c in centroids(images, count)]
        settings = {"size": (ROWS, COLS), "fov_estimate": FOV_DEG, "fov_max_error": 0.5}
        return lambda: [solver.solve_from_centroids(c, **settings) for c in lists]

    def boresight(result: Any) -> np.ndarray | None:
        return None if result["RA"] is None else towards(result["RA"], result["Dec"])

    return [Peer("cedar-solve", "lost", count, prepare, boresight)]


def score_peer(peer: Peer, results: list[Any], images: Images) -> dict:
    axes = [peer.boresight(result) for result in results]
    solved = [e for e, axis in enumerate(axes) if axis is not None]
    wrong = sum(bool(axes[e] @ images.c_di[e, 2] < np.cos(WRONG_RAD)) for e in solved)
    return {"solved": len(solved) / len(axes), "wrong": wrong}


def run_scene(
    scene: Scene, images: Images, matcher: Matcher, peers: Sequence[Peer], seed: int
) -> dict:
    """Return a row: per method and peer microseconds an exposure, solved share, wrong solutions."""
    hints = hints_near(images, seed)
    ours = {
        "lost": identification(images, matcher, "lost-in-space", None),
        "guided": identification(images, matcher, "guided", hints),
    }
    row: dict[str, Any] = {"scene": scene.name, "missing": {}}
    solvers, results = {}, {}
    for peer in peers:
        solve = peer.prepare(images, hints)
        try:
            results[peer.name] = solve()
            solvers[peer.name] = solve
        except Exception as error:  # as in make_peers
            row["missing"][peer.name] = f"{type(error).__name__}: {error}"
    times = paired_times(ours | solvers)
    count = images.frames.n_frames
    row["stars"] = images.frames.n_stars / count
    matched = {name: function() for name, function in ours.items()}
    for name, found in matched.items():
        row[name] = score(found, images) | {"us": 1e6 * float(np.median(times[name])) / count}
    row["differ"] = disagreements(matched["lost"], matched["guided"]).tolist()
    for peer in peers:
        if peer.name in solvers:
            each = times[peer.name] / peer.exposures
            row[peer.name] = score_peer(peer, results[peer.name], images) | {
                "us": 1e6 * float(np.median(each)),
                "beside": peer.beside,
                "ratio": float(np.median(times[peer.beside] / count / each)),
            }
    return row


def report(row: dict, names: Sequence[str], exposures: int) -> None:
    """Print a scene: a line for each method and peer, with our time over the peer's."""
    print(f"{row['scene']} ({row['stars']:.1f} stars)")
    for name in names:
        if name not in row:
            print(f"  {name:18s} missing: {row['missing'].get(name, 'see above')}")
            continue
        one = row[name]
        line = f"  {name:18s} {one['us']:7.1f} us  solved {one['solved']:.4f}  wrong {one['wrong']}"
        if "matched" in one:
            line += f"  false matches {one['false_matches']} of {one['matched']}"
        else:
            line += f"  our {one['beside']} takes {one['ratio']:.3f} of it"
        print(line)
    share = 1.0 - len(row["differ"]) / exposures
    where = f"; not in exposures {row['differ']}" if row["differ"] else ""
    print(f"  both methods agree on every star in {share:.2%} of exposures{where}", flush=True)


def run(options: Options) -> dict:
    """Measure all scenes; returns the document with a row for each."""
    config = load_config(Path(__file__).parents[1] / "configs" / "st16.toml")
    section = config.catalogue
    catalogue = select(load_bundled(), section.limiting_magnitude, section.merge_separation_arcsec)
    peers, missing = make_peers(options)
    for name, reason in missing.items():
        print(f"{name} is missing: {reason}")
    names = ["lost", "guided", *(peer.name for peer in peers)]
    matcher, rows = Matcher(catalogue, config), []
    for k, scene in enumerate(SCENES):
        images = make_images(scene, options.exposures, catalogue, options.seed + k)
        rows.append(run_scene(scene, images, matcher, peers, k))
        report(rows[-1], names, options.exposures)
    return {"exposures": options.exposures, "missing": missing, "rows": rows}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--exposures", type=int, default=Options.exposures)
    parser.add_argument("--cedar-exposures", type=int, default=Options.cedar_exposures)
    parser.add_argument("--seed", type=int, default=Options.seed)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    options = Options(arguments.exposures, arguments.cedar_exposures, arguments.seed)
    document = run(options)
    if arguments.json:
        arguments.json.write_text(json.dumps(document, indent=1))


if __name__ == "__main__":
    main()
