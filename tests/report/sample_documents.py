"""Synthetic report documents: plausible in shape and size, the numbers mean nothing."""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np

# name, initial, fitted, sd, sigma (Enright 2018 Table II)
PARAMETERS = (
    ("f_m", 0.016, 0.01598712, 3.1e-7, 8e-6),
    ("m0_px", 972.0, 1012.44, 2.6, 30.0),
    ("n0_px", 1296.0, 1261.07, 2.4, 30.0),
    ("b4_per_m4", 0.0, 8.1e7, 6.2e6, 1e8),
    ("b2_per_m2", 0.0, -1234.5, 41.0, 1e3),
    ("a1_rad", 0.0, -0.0123, 0.0009, 0.01),
    ("a2_rad", 0.0, 0.0151, 0.001, 0.01),
    ("g_y", 1.0, 1.00021, 1.4e-5, 2e-4),
)


def fit_document(frames: int = 120, seed: int = 1) -> dict[str, Any]:
    random = np.random.default_rng(seed)
    size = len(PARAMETERS)
    mixed = random.normal(size=(size, 3 * size))
    mixed[1] = mixed[6] + 0.2 * mixed[1]
    mixed[2] = -mixed[5] + 0.25 * mixed[2]
    sd = np.array([p[3] for p in PARAMETERS])
    correlation = np.corrcoef(mixed)
    _, values, vectors = np.linalg.svd(random.normal(size=(40, size)) * np.logspace(2, 0, size))
    return {
        "schema": "stcal.fit/1",
        "sensor_id": "ST16-1",
        "software": "stcal 0.0 (synthetic)",
        "created_utc": "2026-01-06T00:00:00.000Z",
        "method": "batch",
        "residual": "arclength",
        "matches": "telemetry",
        "verdict": {"accepted": True, "reasons": []},
        "frames": frames,
        "frames_solved": {"initial": frames - 30, "fitted": frames - 2},
        "matched_stars": {"initial": 11 * frames, "fitted": 20 * frames},
        "exposures_used": 2 * frames - 7,
        "stars_used": 20 * frames,
        "residuals": 35 * frames,
        "span": {"from": "2026-01-05T00:00:00.000Z", "to": "2026-01-05T06:00:00.000Z"},
        "cycles": [_cycle(k) for k in range(1, 4)],
        "settled": True,
        "parameters": [_parameter(*p) for p in PARAMETERS],
        "estimated_parameters": [p[0] for p in PARAMETERS],
        "covariance": (correlation * np.outer(sd, sd)).tolist(),
        "correlation": correlation.tolist(),
        "condition": {"raw": 3.2e14, "scaled": float(values[0] / values[-1])},
        "singular_values": values.tolist(),
        "singular_vectors": vectors.T.tolist(),
        "observability": "m0 and a2 are nearly indistinguishable: 0.71 m0 + 0.70 a2 is known "
        "131 times less well than the best combination.",
        "rms_urad": {"initial": 422.61, "fitted": 80.34},
        "noise": {"sd_px": 0.4, "scale": 1.021},
        "coverage": 0.953,
        "c_sd": {
            "matrix": [[0.99999951, -1e-4, 0.001], [1e-4, 0.99999999, -2e-4], [-0.001, 2e-4, 1.0]],
            "offset_arcsec": [-3051.22, 2711.9, 14.05],
            "spread_arcsec": [6.2, 5.9, 41.0],
            "sd_of_mean_arcsec": [0.41, 0.4, 2.8],
            "frames_used": frames - 9,
            "frames_rejected": 1,
        },
        "field": field(random),
        "radial": radial(),
        "series": series(frames, random, ("initial", "fitted")),
        "provenance": {
            "telemetry_sha256": "a" * 64,
            "catalogue_sha256": "b" * 64,
            "config_sha256": "c" * 64,
            "parent_sha256": "d" * 64,
            "software": "stcal 0.0 (synthetic)",
            "from": "2026-01-05T00:00:00.000Z",
            "to": "2026-01-05T06:00:00.000Z",
        },
    }


def sequential_document(frames: int = 120, seed: int = 3) -> dict[str, Any]:
    """A filter's fit: with process noise, one fallback, and a decision on temperature."""
    document = fit_document(frames, seed)
    del document["cycles"], document["settled"]
    return document | {
        "method": "sequential sqrf",
        "matches": "lost-in-space",
        "sequential": {
            "variant": {
                "method": "sqrf",
                "precision": "double",
                "matches": "lost-in-space",
                "rematch": True,
                "process_noise": {"f_m": 0.5, "m0_px": 0.1, "n0_px": 0.1, "g_y": 0.0},
                "parameters": None,
                "temperature": ["f_m"],
                "shadow": True,
            },
            "frames": frames,
            "frames_updated": frames - 3,
            "innovations": {
                "count": 35 * frames,
                "per_arc": 1.4951,
                "scaled_per_arc": 1.0021,
                "noise_scale": 1.2215,
                "confidence": 0.95,
                "within": 0.9475,
                "lag_one": -0.0084,
            },
            "availability": {"estimate": 0.99, "baseline": 0.81, "used": 0.9666},
            "matched_stars": {"estimate": 20 * frames, "baseline": 11 * frames},
            "stars_rejected": 17,
            "step_to_optimum_sd": 0.143,
            "linearised_anew": 55,
            "events": [
                {
                    "frame_id": 37,
                    "time_utc": "2026-01-05T01:48:00.000Z",
                    "event": "fewer stars matched",
                }
            ],
            "on_baseline": False,
            "temperature": {
                "reference_c": 20.0,
                "range_c": [12.0, 28.01],
                "frames_without": 2,
                "twice_log_evidence": 412.34,
                "needed": 10.0,
                "chosen": True,
                "slopes_per_k": {"f_m": {"value": 2.0027e-6, "sd": 7.8e-9}},
            },
            "history": _filter_history(frames, np.random.default_rng(seed)),
        },
    }


def _filter_history(frames: int, random: np.random.Generator) -> dict[str, Any]:
    shown = np.arange(0, frames, max(1, math.ceil(frames / 600)))
    spread = 1.0 / np.sqrt(1.0 + shown)
    stars = random.poisson(20, len(shown))
    start = np.datetime64("2026-01-05T00:00:00.000")
    return {
        "time_utc": [f"{start + int(k) * np.timedelta64(180_000, 'ms')}Z" for k in shown],
        "frame_id": (shown + 1).tolist(),
        "parameters": {
            name: {
                "value": (fitted + 20.0 * sd * spread * random.normal(size=len(shown))).tolist(),
                "sd": (20.0 * sd * spread).tolist(),
            }
            for name, _, fitted, sd, _ in PARAMETERS
        },
        "nis_per_arc": (1.5 * random.chisquare(40, len(shown)) / 40).tolist(),
        "arcs": (2 * stars).tolist(),
        "noise_scale": np.full(len(shown), 1.22).tolist(),
        "matched": stars.tolist(),
        "matched_baseline": (stars // 2).tolist(),
        "on_baseline": ((shown > 36) & (shown < 61)).tolist(),
    }


def validation_document(frames: int = 120, seed: int = 2) -> dict[str, Any]:
    random = np.random.default_rng(seed)
    return {
        "schema": "stcal.validation/1",
        "sensor_id": "ST16-1",
        "software": "stcal 0.0 (synthetic)",
        "created_utc": "2026-01-06T00:00:00.000Z",
        "verdict": {"accepted": True, "reasons": []},
        "frames": frames,
        "counted_frames": frames - 2,
        "confidence": 0.95,
        "availability": {
            "baseline": 0.4412,
            "candidate": 0.9787,
            "interval": {"baseline": [0.352, 0.531], "candidate": [0.951, 1.0]},
        },
        "matched_stars": {"baseline": 812, "candidate": 1998},
        "matched_star_ratio": 2.4606,
        "matched_star_ratio_interval": [2.11, 2.93],
        "common_pair_rms_urad": {
            "baseline": 377.04,
            "candidate": 89.93,
            "interval": {"baseline": [351.0, 402.0], "candidate": [86.0, 94.0]},
        },
        "rms_ratio": 0.2385,
        "rms_ratio_interval": [0.221, 0.26],
        "pairs": 5120,
        "pairs_from": "baseline",
        "attitude_offset_arcsec": [0.31, -0.22, 1.9],
        "attitude_spread_arcsec": [6.1, 5.8, 40.2],
        "attitude_sd_of_mean_arcsec": [0.4, 0.4, 2.7],
        "matching": "lost-in-space",
        "provenance": {"telemetry_sha256": "f" * 64, "software": "stcal 0.0 (synthetic)"},
        "field": field(random),
        "radial": radial(),
        "series": series(frames, random, ("baseline", "candidate")),
        "baseline": {"serial": 1, "sha256": "d" * 64},
        "candidate": {"serial": 2, "sha256": "e" * 64},
        "span": {"from": "2026-01-05T06:00:00.000Z", "to": "2026-01-05T12:00:00.000Z"},
    }


def field(random: np.random.Generator) -> dict[str, Any]:
    rows, cols = 1944, 2592
    m, n = np.meshgrid(
        (np.arange(9) + 0.5) * rows / 9, (np.arange(12) + 0.5) * cols / 12, indexing="ij"
    )
    m, n = m.ravel(), n.ravel()
    x, y = m - rows / 2, n - cols / 2
    bent = 2e-7 * (x * x + y * y)
    before = np.stack([bent * x / 300 + 0.4, bent * y / 300 - 0.2]) + random.normal(
        0, 0.1, (2, len(m))
    )
    after = random.normal(0, 0.05, (2, len(m)))
    stars = random.integers(1, 60, len(m))
    return {
        "row_px": m.tolist(),
        "col_px": n.tolist(),
        "count": stars.tolist(),
        "before_row_px": before[0].tolist(),
        "before_col_px": before[1].tolist(),
        "after_row_px": after[0].tolist(),
        "after_col_px": after[1].tolist(),
        "rows": rows,
        "cols": cols,
    }


def radial() -> dict[str, Any]:
    radius = np.linspace(80, 1550, 10)
    return {
        "radius_px": radius.tolist(),
        "before_px": (1.2e-9 * radius**3 - 0.3).tolist(),
        "after_px": (0.02 * np.sin(radius / 200)).tolist(),
        "sd_after_px": np.linspace(0.5, 0.3, 10).tolist(),
        "count": list(range(40, 140, 10)),
    }


def series(frames: int, random: np.random.Generator, labels: tuple[str, str]) -> dict[str, Any]:
    start = np.datetime64("2026-01-05T00:00:00.000")
    times = start + np.arange(frames) * np.timedelta64(180_000, "ms")
    fixes = [random.random(frames) < share for share in (0.6, 0.97)]
    stars = [random.poisson(mean, frames) * fix for mean, fix in zip((7, 13), fixes, strict=True)]
    return {
        "time_utc": [f"{time}Z" for time in times],
        f"matched_{labels[0]}": stars[0].tolist(),
        f"matched_{labels[1]}": stars[1].tolist(),
        f"fix_{labels[0]}": fixes[0].tolist(),
        f"fix_{labels[1]}": fixes[1].tolist(),
    }


def hollow(document: dict[str, Any]) -> dict[str, Any]:
    """The same document with every number null and every list empty."""
    return copy.deepcopy({key: _hollow(value) for key, value in document.items()}) | {
        "schema": document["schema"]
    }


def _hollow(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _hollow(item) for key, item in value.items()}
    return [] if isinstance(value, list) else None


def _cycle(number: int) -> dict[str, Any]:
    return {
        "cycle": number,
        "matching": "telemetry" if number == 1 else "guided",
        "frames_solved": 100 + 5 * number,
        "exposures_solved": 205 + 9 * number,
        "matched_stars": 1500 + 200 * number,
        "stars_fitted": 700 * number,
        "matches_changed": 600 // number**3,
        "iterations": 7 - number,
        "rms_urad": 100.0 - 6.0 * number,
        "chi2": 4100.0 + number,
        "dof": 4000,
        "noise_scale": 1.02,
        "stars_rejected": 12 - number,
        "change_sd": 3.1 / 10**number if number > 1 else None,
    }


def _parameter(name: str, initial: float, fitted: float, sd: float, sigma: float) -> dict[str, Any]:
    change = fitted - initial
    return {
        "name": name,
        "initial": initial,
        "fitted": fitted,
        "sd": sd,
        "change": change,
        "change_sigma": change / sigma,
        "change_sd": change / sd,
        "sigma": sigma,
    }
