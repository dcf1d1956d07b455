"""Frames, files and comparisons that the telemetry tests share."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from stcal.config import SensorConfig, load_config
from stcal.frames import FrameBatch
from stcal.telemetry import csv, jsonl
from stcal.telemetry.decoders import DECODERS
from stcal.telemetry.ingest import ingest
from stcal.telemetry.store import Store
from stcal.telemetry.summary import IngestSummary

ROOT = Path(__file__).parents[2]
T0_NS = 1_767_614_437_000_000_000  # 2026-01-05T12:00:00Z in TAI
SECOND_NS = 1_000_000_000
STAR_IDS = (0, 0, 27989, 24436, 2**40 + 129_018_731, 2**40 + 4_619_000_011)

# One row of the long form, by column.
ROW = {
    "sensor_id": "ST16-1",
    "frame_id": "7",
    "time_utc": "2026-01-05T12:00:00.000Z",
    "best_exposure": "0",
    "q_x": "0.5",
    "q_y": "0.5",
    "q_z": "0.5",
    "q_w": "0.5",
    "rate_x_deg_s": "0.01",
    "rate_y_deg_s": "",
    "rate_z_deg_s": "-0.02",
    "temperature_c": "20.5",
    "exposure": "0",
    "row_px": "100.25",
    "col_px": "200.5",
    "intensity": "1500",
    "star_id": "HIP 27989",
}
OPTIONAL = ("eclipse", "intrusion", "pos_x_km", "pos_y_km", "pos_z_km")
OPTIONAL += ("vel_x_km_s", "vel_y_km_s", "vel_z_km_s")


def config(**detector: float) -> SensorConfig:
    """Return the ST-16's configuration, with changes of its detector."""
    whole = load_config(ROOT / "configs" / "st16.toml")
    return whole.model_copy(update={"detector": whole.detector.model_copy(update=detector)})


def run(tmp_path: Path, *files: Path, **options: object) -> tuple[Store, IngestSummary]:
    """Ingest files into the store ``tmp_path/store``."""
    store = Store.open(tmp_path / "store", create=True)
    configs = options.pop("configs", None) or [config()]
    return store, ingest(list(files), store, configs, **options)


@contextmanager
def small_blocks(block_bytes: int) -> Iterator[None]:
    """Let files be read in blocks of this size, so that windows end within them."""
    whole = dict(DECODERS)
    for name, module in (("csv", csv), ("jsonl", jsonl)):
        decode = partial(module.decode, block_bytes=block_bytes)
        DECODERS[name] = replace(whole[name], decode=decode)
    try:
        yield
    finally:
        DECODERS.update(whole)


def rows(n: int, **changes: str) -> list[dict[str, str]]:
    """Return n rows of one frame, their centroids apart."""
    return [ROW | {"row_px": f"{100 + 10 * i}.25", "star_id": ""} | changes for i in range(n)]


def frames(n_frames: int, n_stars: int = 3) -> list[dict[str, str]]:
    """Return the rows of several frames, 40 s apart."""
    return [
        row
        for f in range(n_frames)
        for row in rows(
            n_stars,
            frame_id=str(f),
            time_utc=f"2026-01-05T12:{(40 * f) // 60:02d}:{(40 * f) % 60:02d}.000Z",
        )
    ]


def csv_text(table: list[dict[str, str]], extra: tuple[str, ...] = ()) -> str:
    """Return rows as CSV text."""
    names = [*ROW, *extra]
    lines = [",".join(names)]
    lines += [",".join(row.get(name, "") for name in names) for row in table]
    return "\n".join(lines) + "\n"


def write_rows(path: Path, table: list[dict[str, str]], extra: tuple[str, ...] = ()) -> Path:
    """Write rows as a CSV file."""
    path.write_text(csv_text(table, extra))
    return path


def records(store: Store) -> list[dict]:
    """Return the quarantine's records."""
    return store.quarantine().to_pylist()


def snapshot(root: Path) -> dict[str, str]:
    """Return the hash of every file of a store except the lock."""
    return {
        str(path.relative_to(root)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(root.rglob("*"))
        if path.is_file() and path.name != ".lock"
    }


def assert_same_frames(a: FrameBatch, b: FrameBatch) -> None:
    """Every column of both batches must be equal, NaN being equal to NaN."""
    assert a.sensor_id == b.sensor_id
    for name, column in vars(a).items():
        if isinstance(column, np.ndarray):
            np.testing.assert_array_equal(column, getattr(b, name), err_msg=name)
            assert column.dtype == getattr(b, name).dtype, name


def batch(n: int = 30, seed: int = 0, sensor_id: str = "ST16-1", mean: float = 3.0) -> FrameBatch:
    """Return random frames in the store's order, some empty, values of CSV precision."""
    rng = np.random.default_rng(seed)
    counts = rng.poisson(mean, 2 * n)
    offsets = np.concatenate(([0], np.cumsum(counts)))
    n_stars = int(offsets[-1])
    q = rng.normal(size=(n, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    q[rng.random(n) < 0.2] = np.nan
    exposure = np.repeat(np.arange(2 * n), counts)
    intensity = np.round(rng.uniform(1, 5000, n_stars), 2)
    order = np.lexsort((-intensity, exposure))
    state = np.round(rng.normal(size=(n, 3)) * 4000, 4)
    return FrameBatch(
        sensor_id=sensor_id,
        frame_id=np.arange(n),
        t_tai_ns=T0_NS + np.arange(n) * 1100 * SECOND_NS,
        best_exposure=rng.integers(-1, 2, n).astype(np.int8),
        q_si=q,
        rate_deg_s=np.where(rng.random((n, 3)) < 0.1, np.nan, rng.normal(size=(n, 3))),
        temperature_c=np.where(rng.random(n) < 0.1, np.nan, rng.normal(20, 5, n)),
        eclipse=rng.random(n) < 0.1,
        intrusion=rng.random(n) < 0.1,
        pos_km=state,
        vel_km_s=state / 1000,
        star_offsets=offsets,
        row_px=np.round(rng.uniform(0, 1943, n_stars), 4),
        col_px=np.round(rng.uniform(0, 2591, n_stars), 4),
        intensity=intensity[order],
        star_id=rng.choice(np.array(STAR_IDS), n_stars),
    )


@st.composite
def batches(draw: st.DrawFn, sensor_id: str = "ST16-1") -> FrameBatch:
    """Any frames that are valid telemetry, in the store's order."""
    n = draw(st.integers(1, 6))
    counts = draw(st.lists(st.integers(0, 4), min_size=2 * n, max_size=2 * n))
    n_stars = sum(counts)

    def reals(low: float, high: float, size: int, empty: bool = True) -> np.ndarray:
        value = st.floats(low, high).map(lambda x: x + 0.0)
        value = value | st.just(float("nan")) if empty else value
        return np.array(draw(st.lists(value, min_size=size, max_size=size)), dtype=np.float64)

    def whole(element: st.SearchStrategy, size: int, kind: type) -> np.ndarray:
        return np.array(draw(st.lists(element, min_size=size, max_size=size)), dtype=kind)

    q = reals(-1, 1, 4 * n, empty=False).reshape(n, 4) + np.array([0, 0, 0, 3.0])
    q /= np.linalg.norm(q, axis=1)[:, None]
    q[whole(st.booleans(), n, bool)] = np.nan
    state = reals(-1e5, 1e5, 6 * n, empty=False).reshape(n, 6)
    state[whole(st.booleans(), n, bool)] = np.nan
    gaps = whole(st.integers(1, 2 * 86_400 * SECOND_NS), n, np.int64)
    frame = np.repeat(np.arange(2 * n), counts)
    stars = {
        "row_px": reals(-0.5, 1943.5, n_stars, empty=False),
        "col_px": reals(-0.5, 2591.5, n_stars, empty=False),
        "intensity": reals(-1e6, 1e6, n_stars),
        "star_id": whole(st.sampled_from(STAR_IDS), n_stars, np.int64),
    }
    keys = (stars["star_id"], stars["col_px"], stars["row_px"], -stars["intensity"], frame)
    order = np.lexsort(keys)
    return FrameBatch(
        sensor_id=sensor_id,
        frame_id=np.arange(n) + draw(st.integers(-(10**17), 10**17)),
        t_tai_ns=T0_NS + np.cumsum(gaps),
        best_exposure=whole(st.integers(-1, 1), n, np.int8),
        q_si=q,
        rate_deg_s=reals(-10, 10, 3 * n).reshape(n, 3),
        temperature_c=reals(-100, 100, n),
        eclipse=whole(st.booleans(), n, bool),
        intrusion=whole(st.booleans(), n, bool),
        pos_km=state[:, :3],
        vel_km_s=state[:, 3:],
        star_offsets=np.concatenate(([0], np.cumsum(counts))).astype(np.int64),
        **{name: column[order] for name, column in stars.items()},
    )


def without_repeated_stars(frames: FrameBatch) -> bool:
    """Whether no exposure holds one star twice, value by value (the store drops the second)."""
    keys = zip(
        frames.exposure_of_star.tolist(),
        frames.row_px.tolist(),
        frames.col_px.tolist(),
        np.nan_to_num(frames.intensity, nan=-9e9).tolist(),
        frames.star_id.tolist(),
        strict=True,
    )
    listed = list(keys)
    return len(set(listed)) == len(listed)
