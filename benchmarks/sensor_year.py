"""A sensor-year and parts of it through the commands: time, processor time and peak memory.

`stcal simulate --fragments` makes the telemetry (kept in --folder and used again); then ingest,
match, fit --batch and validate each run as a process of their own on all of it.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
SENSOR, YEAR = "ST16-1", 3_150_000


def command(*arguments: object) -> dict:
    """Run a command; return seconds, processor seconds, peak memory and megabytes read."""
    start = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-m", "stcal", *map(str, arguments)], stdout=subprocess.DEVNULL
    )
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise SystemExit(f"stcal {arguments[0]} ended with exit code {process.returncode}")
    return {
        "seconds": time.perf_counter() - start,
        "cpu_s": used.ru_utime + used.ru_stime,
        "peak_mib": used.ru_maxrss / 1024,
        "read_mb": used.ru_inblock * 512 / 1e6,
    }


def telemetry(folder: Path, frames: int, workers: int) -> None:
    """Simulate so many frames into a folder, unless it has them already."""
    if not (folder / "calibration").is_dir():
        scenario = ROOT / "configs" / "scenarios" / "st16-year.toml"
        command("simulate", scenario, "--out", folder, "--fragments", "--frames", frames,
                "--workers", workers, "--no-truth-columns")  # fmt: skip


def measure(folder: Path, workers: int) -> dict:
    """Run the four commands on a folder of simulated telemetry."""
    out = folder / "measured"
    shutil.rmtree(out, ignore_errors=True)
    store = ("--store", out / "store")
    of_sensor = (*store, "--sensor", SENSOR, "--workers", workers)
    initial, fitted = folder / f"{SENSOR}.initial.json", out / "fit" / "calibration.json"
    config = ROOT / "configs" / "st16.toml"
    rows = {
        "ingest": command("ingest", folder / "calibration", *store, "--config", config,
                          "--workers", workers),
        "match": command("match", *of_sensor, "--calibration", initial, "--out", out / "match"),
        "fit": command("fit", "--batch", *of_sensor, "--initial", initial, "--out", out / "fit"),
        "validate": command("validate", *of_sensor, "--baseline", initial, "--candidate", fitted,
                            "--out", out / "validate"),
    }  # fmt: skip
    document = json.loads((out / "fit" / "fit.json").read_text())
    shutil.rmtree(out)
    figures = {"frames": document["frames"], "stars_used": document["stars_used"]}
    return figures | {"cycles": len(document["cycles"]), "commands": rows}


def report(found: dict) -> None:
    """Print the figures of one part."""
    print(f"{found['frames']} frames, {found['cycles']} cycles, {found['stars_used']} stars used")
    for name, row in found["commands"].items():
        print(
            f"  {name:9s} {row['seconds']:7.1f} s  processor {row['cpu_s']:7.1f} s  "
            f"peak {row['peak_mib']:6.0f} MiB  read {row['read_mb']:7.0f} MB"
        )
    total = sum(row["seconds"] for row in found["commands"].values())
    print(f"  {'together':9s} {total:7.1f} s, {1e6 * total / found['frames']:.0f} us a frame")


def main() -> None:
    """Measure parts of a year, and write the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, required=True, help="where the telemetry is kept")
    parser.add_argument("--percent", type=float, nargs="+", default=[1, 10, 100])
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found = []
    for percent in options.percent:
        folder = options.folder / f"{percent:g}"
        telemetry(folder, round(YEAR * percent / 100), options.workers)
        found.append(measure(folder, options.workers))
        report(found[-1])
        if options.json:
            options.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
