"""Time the ingest of telemetry into a new store: rows of CSV a second, packets a second.

The telemetry is simulated, a file a day, or that of a folder.  Each figure is the best of several
runs in a process of its own, which also gives the peak memory.  Beside the files as they are, one
day comes in forty pieces.  As a bare lower bound, pandas reads the same CSV files and writes them
as Parquet, without looking at a value.
"""

from __future__ import annotations

import argparse
import gzip
import json
import resource
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from stcal.config import load_config
from stcal.simulate import load_scenario, with_frames
from stcal.simulate.fragments import Output, lay_out, write_fragments
from stcal.telemetry.ingest import ingest
from stcal.telemetry.packet_layout import load_layout
from stcal.telemetry.store import Store

ROOT = Path(__file__).parents[1]
CONFIG = ROOT / "configs" / "st16.toml"
SCENARIO = ROOT / "configs" / "scenarios" / "st16-year.toml"
LAYOUT = ROOT / "configs" / "packets" / "st16.toml"
PIECES = 40


def simulate_telemetry(folder: Path, frames: int) -> None:
    """Write a simulated sensor's calibration telemetry, as CSV and as packets, a file a day."""
    plan = lay_out(with_frames(load_scenario(SCENARIO), "calibration", frames), 1)
    write_fragments(plan, Output(folder, False, load_layout(LAYOUT)))


def cut(path: Path, folder: Path) -> None:
    """Write a day's file as pieces one after another."""
    header, *lines = gzip.decompress(path.read_bytes()).splitlines(keepends=True)
    folder.mkdir()
    size = -(-len(lines) // PIECES)
    for k in range(PIECES):
        piece = header + b"".join(lines[k * size : (k + 1) * size])
        (folder / f"{k:02}.csv.gz").write_bytes(gzip.compress(piece, 3, mtime=0))


def by_stcal(folder: Path, workers: int, runs: int) -> dict[str, Any]:
    """Return the figures of the ingest of a folder's files."""
    config, packets = load_config(CONFIG), None
    if any(folder.glob("*.ccsds")):
        packets = load_layout(LAYOUT)
    seconds, cpu_s = [], []
    for _ in range(runs):
        with tempfile.TemporaryDirectory() as root:
            store = Store.open(Path(root) / "store", create=True)
            start, cpu = time.perf_counter(), time.process_time()
            summary = ingest([folder], store, [config], packets=packets, workers=workers)
            seconds.append(time.perf_counter() - start)
            cpu_s.append(time.process_time() - cpu)
    counts = summary.counts
    return _figures(counts.rows, min(seconds), min(cpu_s)) | {
        "frames": counts.frames,
        "frames_per_s": round(counts.frames / min(seconds)),
        "workers": workers,
    }


def by_pandas(folder: Path, runs: int) -> dict[str, Any]:
    """Return the figures of reading a folder's CSV files and writing each as Parquet."""
    import pandas as pd

    seconds, cpu_s = [], []
    for _ in range(runs):
        with tempfile.TemporaryDirectory() as root:
            start, cpu, rows = time.perf_counter(), time.process_time(), 0
            for path in sorted(folder.glob("*.csv.gz")):
                table = pd.read_csv(path)
                rows += len(table)
                table.to_parquet(Path(root) / f"{path.name}.parquet", compression="zstd")
            seconds.append(time.perf_counter() - start)
            cpu_s.append(time.process_time() - cpu)
    return _figures(rows, min(seconds), min(cpu_s))


def _figures(rows: int, seconds: float, cpu_s: float) -> dict[str, Any]:
    peak_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {
        "rows": rows,
        "seconds": round(seconds, 3),
        "cpu_s": round(cpu_s, 3),
        "rows_per_s": round(rows / seconds),
        "peak_mib": round(peak_kib / 1024),
    }


def _alone(function: Any, *arguments: Any) -> dict[str, Any]:
    """Call a function in a process of its own."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return dict(pool.submit(function, *arguments).result())


def measure(folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Return the figures of a simulation's telemetry."""
    day, *_ = sorted((folder / "calibration").glob("*.csv.gz"))[1:] or [None]
    sources = {"csv": folder / "calibration", "packets": folder / "packets" / "calibration"}
    with tempfile.TemporaryDirectory() as pieces:
        if day is not None:
            sources["csv in forty pieces"] = Path(pieces) / "day"
            cut(day, sources["csv in forty pieces"])
        return {
            f"{name}, workers {workers}": _alone(by_stcal, source, workers, options.runs)
            for name, source in sources.items()
            if source.is_dir()
            for workers in options.workers
        } | {"pandas": _alone(by_pandas, sources["csv"], options.runs)}


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Return the benchmark's document."""
    if options.folder is not None:
        return measure(options.folder, options)
    with tempfile.TemporaryDirectory() as folder:
        simulate_telemetry(Path(folder), options.frames)
        return measure(Path(folder), options)


def main() -> None:
    """Parse the command line, print the figures and write them as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=20_000)
    parser.add_argument("--folder", type=Path, help="of `stcal simulate --fragments`, as it is")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    result = run(options)
    for name, figures in result.items():
        print(
            f"{name:32} {figures['rows_per_s']:9,} rows/s  {figures['seconds']:7.2f} s  "
            f"cpu {figures['cpu_s']:7.2f} s  peak {figures['peak_mib']:5} MiB"
        )
    if options.json is not None:
        options.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
