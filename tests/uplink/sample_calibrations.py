"""Synthetic calibration files that an upload may be built from; the numbers mean nothing."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

WANG = {
    "f_m": 0.016,
    "m0_px": 972.0,
    "n0_px": 1296.0,
    "b4_per_m4": 0.0,
    "b2_per_m2": 0.0,
    "a1_rad": 0.0,
    "a2_rad": 0.0,
    "g_y": 1.0,
}
SD = (2e-7, 2.0, 2.5, 5e6, 40.0, 1e-3, 1e-3, 1e-5)


def parent_document(**parameters: float) -> dict[str, Any]:
    return {
        "schema": "stcal.calibration/1",
        "sensor_id": "ST16-1",
        "serial": 1,
        "camera": {
            "model": "wang",
            "rows": 1944,
            "cols": 2592,
            "pixel_size_m": 2.2e-6,
            "parameters": {**WANG, **parameters},
        },
        "c_sd": np.eye(3).tolist(),
    }


def fitted_document(parent_sha256: str, **parameters: float) -> dict[str, Any]:
    hashes = {f"{key}_sha256": key[0] * 64 for key in ("catalogue", "telemetry", "config")}
    hashes = {key: value.replace("t", "d") for key, value in hashes.items()}
    return {
        **parent_document(**parameters),
        "serial": 2,
        "c_sd": rotation_z(1e-3),
        "covariance": {"parameters": list(WANG), "matrix": np.diag(np.square(SD)).tolist()},
        "provenance": {
            **hashes,
            "parent_sha256": parent_sha256,
            "software": "synthetic",
            "from": "2026-01-01T00:00:00.000Z",
            "to": "2026-01-02T00:00:00.000Z",
        },
        "quality": {
            "verdict": {"accepted": True, "reasons": []},
            "frames": 400,
            "stars_used": 12000,
            "coverage": 0.99,
            "condition": {"scaled": 150.0},
            "rms_urad": {"initial": 700.0, "fitted": 90.0},
        },
    }


def validation_document(candidate: str, baseline: str) -> dict[str, Any]:
    return {
        "schema": "stcal.validation/1",
        "sensor_id": "ST16-1",
        "verdict": {"accepted": True, "reasons": []},
        "candidate": {"serial": 2, "sha256": candidate},
        "baseline": {"serial": 1, "sha256": baseline},
        "span": {"from": "2026-01-03T00:00:00.000Z", "to": "2026-01-04T00:00:00.000Z"},
        "confidence": 0.95,
        "availability": {
            "baseline": 0.87,
            "candidate": 1.0,
            "interval": {"baseline": [0.81, 0.92], "candidate": [1.0, 1.0]},
        },
        "matched_stars": {"baseline": 1372, "candidate": 2308},
        "matched_star_ratio": 1.68,
        "matched_star_ratio_interval": [1.58, 1.8],
        "rms_ratio": 0.127,
        "rms_ratio_interval": [0.123, 0.132],
    }


def rotation_z(angle: float) -> list[list[float]]:
    c, s = float(np.cos(angle)), float(np.sin(angle))
    return [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]


def write(path: Path, document: dict[str, Any]) -> str:
    """Write JSON (NaN allowed) and return its SHA-256."""
    path.write_text(json.dumps(document))
    return hashlib.sha256(path.read_bytes()).hexdigest()


def write_pair(folder: Path, **parameters: float) -> tuple[Path, Path]:
    """Write a parent and its fitted successor, return (new, parent)."""
    parent, new = folder / "old.json", folder / "new.json"
    write(new, fitted_document(write(parent, parent_document()), **parameters))
    return new, parent
