"""What Enright, Jovanovic & Vaz 2018 publish: Tables III to VII, in the shape of the document."""

from __future__ import annotations

from typing import Any

SENSORS = (1, 2, 3, 4, 5, 6)
# The sensors that the paper shows: Figures 3 and 4, Figure 5, Table VII.
SHOWN = {"convergence": 4, "errors": 4, "radial": 3, "distortion": 2, "settling": 4}

_FILTERS = ("q", "no_q", "no_refit")
_METHODS = ("batch", *_FILTERS)

# Change in standard deviations of Table II, by sensor.
_TABLE_III = {
    "f_m": (-8.54, -8.04, -8.17, -9.46, 0.08, -0.46),
    "m0_px": (1.34, 0.71, 1.12, 0.39, -2.59, 3.16),
    "n0_px": (1.68, -8.37, 1.61, 8.08, 4.00, -9.81),
    "b4_per_m4": (1.04, 1.41, 1.37, 0.67, -0.10, 0.44),
    "b2_per_m2": (-1.03, -1.17, -1.22, -0.90, 0.09, -0.60),
    "a1_rad": (0.51, -4.96, 1.02, 3.58, 2.34, -4.93),
    "a2_rad": (0.15, 0.47, 0.41, -0.10, -1.52, 1.94),
    "g_y": (3.76, 5.14, 3.05, 2.97, 0.36, -1.30),
}
# Availability initial and final, matched star ratio, RMS initial and final [urad].
_TABLE_IV = {
    1: (0.96, 1.00, 1.55, 422.6, 80.3),
    2: (0.98, 1.00, 1.20, 332.7, 91.4),
    3: (0.44, 0.98, 2.46, 377.0, 89.9),
    4: (0.46, 1.00, 2.70, 412.9, 95.6),
    5: (1.00, 1.00, 1.00, 83.0, 62.2),
    6: (0.93, 0.97, 1.04, 248.3, 123.1),
}
# RMS [urad]: raw, batch, Q, No-Q, No-Refit; then the reduced model's, published for Sensor 1.
_TABLE_V = {
    1: (385.3, 101.8, 108.0, 98.9, 93.5),
    2: (316.9, 106.8, 118.9, 106.4, 102.1),
    3: (402.1, 86.2, 85.8, 85.0, 90.0),
    4: (415.1, 104.2, 103.6, 105.0, 111.5),
    5: (71.3, 52.9, 59.7, 59.0, 59.2),
    6: (247.4, 174.1, 164.3, 167.5, 201.6),
}
_TABLE_V_REDUCED = {1: (385.3, 175.6, 132.3, 114.0, 103.3)}
# Matched star ratio, then availability: batch, Q, No-Q, No-Refit.
_TABLE_VI = {
    1: (1.41, 1.41, 1.41, 1.41, 1.00, 1.00, 1.00, 1.00),
    2: (1.16, 1.16, 1.16, 1.16, 0.95, 0.95, 0.95, 0.95),
    3: (0.98, 0.99, 1.01, 0.97, 0.95, 0.95, 0.95, 0.95),
    4: (1.01, 1.01, 1.02, 0.88, 0.94, 0.94, 0.94, 0.91),
    5: (1.00, 1.00, 1.00, 1.00, 1.00, 1.00, 1.00, 1.00),
    6: (1.01, 0.99, 0.99, 0.99, 0.85, 0.85, 0.85, 0.85),
}
# Sensor 2 in SI units: batch, Q, No-Q, No-Refit.
_TABLE_VII = {
    "f_m": (16.031e-3, 16.035e-3, 16.039e-3, 16.035e-3),
    "b4_per_m4": (1.370e8, 0.583e8, 0.320e8, 1.374e8),
    "b2_per_m2": (-2.152e3, -1.771e3, -1.662e3, -2.144e3),
}


def published(sensor: int) -> dict[str, Any]:
    """Return what the paper publishes of one sensor, named as the study names its own numbers."""
    return {
        "change_sigma": {name: row[sensor - 1] for name, row in _TABLE_III.items()},
        "calibration": _calibration(sensor),
        "validation": _validation(sensor),
        "distortion": {
            name: dict(zip(_METHODS, row, strict=True))
            for name, row in _TABLE_VII.items()
            if sensor == SHOWN["distortion"]
        },
    }


def _calibration(sensor: int) -> dict[str, Any]:
    initial, final, ratio, rms_initial, rms_final = _TABLE_IV[sensor]
    return {
        "cameras": {
            "raw": {"availability": initial, "rms_urad": rms_initial},
            "batch": {
                "availability": final, "matched_star_ratio": ratio, "rms_urad": rms_final,
            },
        }
    }  # fmt: skip


def _validation(sensor: int) -> dict[str, Any]:
    cameras: dict[str, dict[str, float]] = {
        name: {"rms_urad": value}
        for name, value in zip(("raw", *_METHODS), _TABLE_V[sensor], strict=True)
    }
    ratios, shares = _TABLE_VI[sensor][:4], _TABLE_VI[sensor][4:]
    for name, ratio, share in zip(_METHODS, ratios, shares, strict=True):
        cameras[name] |= {"matched_star_ratio": ratio, "availability": share}
    if sensor in _TABLE_V_REDUCED:
        for name, value in zip(_METHODS, _TABLE_V_REDUCED[sensor][1:], strict=True):
            cameras[f"{name}_reduced"] = {"rms_urad": value}
    return {"cameras": cameras}
