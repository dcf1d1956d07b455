"""Wall time of the commands on the shipped sample, each process whole, and of the job they make."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
SENSOR = "ST16-4"


def stcal(*arguments: object) -> float:
    """Run a command and return its seconds."""
    start = time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "stcal", *map(str, arguments)], check=True, capture_output=True
    )
    return time.perf_counter() - start


def job(folder: Path) -> dict[str, float]:
    """Return the seconds of each command of the main job into a new folder."""
    sample, store = ROOT / "sample_telemetry", ("--store", folder / "store")
    initial, fitted = sample / f"{SENSOR}.initial.json", folder / "fit" / "calibration.json"
    of_sensor = (*store, "--sensor", SENSOR)
    validation = folder / "validation"
    return {
        "ingest": stcal("ingest", *sorted(sample.glob(f"{SENSOR}.*.csv.gz")), *store,
                        "--config", ROOT / "configs" / "st16.toml"),
        "match": stcal("match", *of_sensor, "--calibration", initial, "--out", folder / "match"),
        "fit": stcal("fit", "--batch", *of_sensor, "--initial", initial, "--to", "2014-09-04",
                     "--out", folder / "fit"),
        "validate": stcal("validate", *of_sensor, "--from", "2014-09-04", "--baseline", initial,
                          "--candidate", fitted, "--out", validation),
        "uplink build": stcal("uplink", "build", "--calibration", fitted, "--parent", initial,
                              "--validation", validation / "validation.json",
                              "--store", folder / "store", "--out", folder / "uplink"),
    }  # fmt: skip


def run(rounds: int) -> dict:
    """Return the document: median seconds of each command, and of all together."""
    found = []
    for _ in range(rounds):
        with tempfile.TemporaryDirectory() as folder:
            found.append(job(Path(folder)))
    seconds = {name: float(np.median([one[name] for one in found])) for name in found[0]}
    whole = float(np.median([sum(one.values()) for one in found]))
    return {"seconds": seconds | {"whole job": whole}, "help_s": stcal("--help")}


def main() -> None:
    """Print the times, and write them as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    document = run(options.rounds)
    for name, seconds in document["seconds"].items():
        print(f"stcal {name:14s} {seconds:6.2f} s")
    print(f"stcal --help         {document['help_s']:6.2f} s")
    if options.json:
        options.json.write_text(json.dumps(document, indent=1))


if __name__ == "__main__":
    main()
