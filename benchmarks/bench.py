"""All benchmarks with their peers one by one, then one table of ratios and one JSON file."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
PARTS = ("identification", "batch_fit", "sequential", "packets", "ingest", "commands")


def identification(document: dict) -> Iterator[dict]:
    for row in document["rows"]:
        for peer, one in row.items():
            if isinstance(one, dict) and "ratio" in one:
                us = row[one["beside"]]["us"]
                what = f"{one['beside']}, {row['scene']}"
                yield entry(what, f"{us:.1f} us", peer, f"{one['us']:.1f} us", one["ratio"])
        for peer, reason in (document["missing"] | row["missing"]).items():
            yield entry(row["scene"], "", peer, f"missing: {reason}")


def batch_fit(document: dict) -> Iterator[dict]:
    fits = document["estimator"]["fits"]
    own, what = fits["stcal"], f"batch fit, {document['estimator']['exposures']} exposures"
    for peer, one in fits.items():
        if "missing" in one:
            yield entry(what, "", peer, f"missing: {one['missing']}")
        elif peer != "stcal":
            yield entry(
                what, f"{own['best_s']:.3f} s", peer, f"{one['best_s']:.3f} s",
                one["stcal_over_it"],
            )  # fmt: skip
    far = document["far_start"]
    yield entry(f"batch fit, {far['frames']} frames from far off", f"{far['best_s']:.3f} s")


def sequential(document: dict) -> Iterator[dict]:
    updates = document["updates"]
    for name, one in updates.items():
        if "missing" in one:
            yield entry("filter update", "", name, f"missing: {one['missing']}")
        elif "ratio" in one:
            peer = one["peer"]
            theirs = updates.get(peer, {}).get("us", one["us"] / one["ratio"])
            yield entry(
                f"update, {name}", f"{one['us']:.1f} us", peer, f"{theirs:.0f} us", one["ratio"]
            )


def packets(document: dict) -> Iterator[dict]:
    own = document["decode_packets_s"]
    for peer, rate in document["peers"].items():
        if isinstance(rate, str):
            yield entry("packet decode", f"{own:.0f}/s", peer, f"missing: {rate}")
        else:
            yield entry("packet decode", f"{own:.0f}/s", peer, f"{rate:.0f}/s", rate / own)
    yield entry("packets into a store", f"{document['ingest_packets_s']:.0f}/s")


def ingest(document: dict) -> Iterator[dict]:
    bare = document["pandas"]["rows_per_s"]
    for name, one in document.items():
        if name.startswith("csv, "):
            rate = one["rows_per_s"]
            yield entry(
                f"ingest, {name}", f"{rate} rows/s", "pandas, bare copy", f"{bare} rows/s",
                bare / rate,
            )  # fmt: skip


def commands(document: dict) -> Iterator[dict]:
    for name, seconds in document["seconds"].items():
        yield entry(f"stcal {name}, sample", f"{seconds:.2f} s")


def entry(what: str, own: str, peer: str = "", theirs: str = "", ratio: Any = None) -> dict:
    """Return a line of the table; ``ratio`` is our time over the peer's."""
    return {"what": what, "stcal": own, "peer": peer, "theirs": theirs, "ratio": ratio}


TABLES = {
    "identification": identification,
    "batch_fit": batch_fit,
    "sequential": sequential,
    "packets": packets,
    "ingest": ingest,
    "commands": commands,
}


def show(rows: list[dict]) -> None:
    """Print the table."""
    print(f"\n{'':58} {'stcal':>14}  {'peer':22} {'theirs':>14}  our time / theirs")
    for row in rows:
        ratio = "" if row["ratio"] is None else f"{row['ratio']:.4f}"
        print(f"{row['what']:58} {row['stcal']:>14}  {row['peer']:22} {row['theirs']:>14}  {ratio}")


def main() -> None:
    """Run the parts as processes of their own, and write and print what they found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("bench"))
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    rows, documents = [], {}
    for part in options.parts:
        path = options.out / f"{part}.json"
        print(f"== {part}", flush=True)
        subprocess.run([sys.executable, HERE / f"{part}.py", "--json", path], check=True)
        documents[part] = json.loads(path.read_text())
        rows += list(TABLES[part](documents[part]))
    show(rows)
    whole = {"table": rows, "parts": documents}
    (options.out / "bench.json").write_text(json.dumps(whole, indent=1))


if __name__ == "__main__":
    main()
