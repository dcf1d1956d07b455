"""What rounding to the target's words costs: star vectors over the detector, not digits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from stcal.calibration import Calibration
from stcal.constants import URAD
from stcal.residuals.arclength import separations
from stcal.uplink.compare import detector_grid

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class RoundingEffect:
    """Angles between star vectors in S by the calibration and by what the target holds.

    Attributes
    ----------
    rms_urad, worst_urad : over a grid on the detector, its edges included; infinite where the held
        camera gives no direction
    at_row_px, at_col_px : where the largest is
    """

    rms_urad: float
    worst_urad: float
    at_row_px: float
    at_col_px: float


def held_calibration(values: Mapping[str, Fraction], like: Calibration) -> Calibration:
    """Return the calibration that a target computes with.

    Parameters
    ----------
    values : what the target holds, by the names of stcal.uplink.quantities
    like : gives the camera model and what the target does not hold
    """
    numbers = {name: float(value) for name, value in values.items()}
    camera = replace(
        like.camera,
        rows=int(numbers.get("rows", like.camera.rows)),
        cols=int(numbers.get("cols", like.camera.cols)),
        pixel_size_m=numbers.get("pixel_size_m", like.camera.pixel_size_m),
        parameters=np.array([numbers[name] for name in like.camera.parameter_names]),
    )
    serial = int(values.get("serial", Fraction(like.serial)))
    return Calibration(like.sensor_id, serial, camera, _alignment(numbers))


def _alignment(numbers: Mapping[str, float]) -> Floats:
    """Return C_SD (3, 3) from its elements or from a quaternion, scaled to unit norm."""
    if "c_sd_11" in numbers:
        return np.array([[numbers[f"c_sd_{i}{j}"] for j in (1, 2, 3)] for i in (1, 2, 3)])
    name = "q_sd" if "q_sd_w" in numbers else "q_ds"
    vector = np.array([numbers[f"{name}_{axis}"] for axis in "xyz"])
    scalar = numbers[f"{name}_w"]
    norm = np.hypot(np.linalg.norm(vector), scalar)
    if norm == 0.0:
        return np.full((3, 3), np.nan)
    x, y, z = vector / norm
    w = scalar / norm
    # A(q) = (w^2 - v.v) I + 2 v v^T - 2 w [v x]
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    outer = np.outer((x, y, z), (x, y, z))
    matrix = (w * w - x * x - y * y - z * z) * np.eye(3) + 2.0 * outer - 2.0 * w * cross
    return np.asarray(matrix if name == "q_sd" else matrix.T)


def rounding_effect(calibration: Calibration, held: Calibration) -> RoundingEffect:
    """Return how far rounding turns star vectors in S, camera and C_SD together."""
    m, n = detector_grid(calibration.camera)
    with np.errstate(all="ignore"):  # a broken camera gives infinite angles below
        exact, rounded = (_star_vectors(c, m, n) for c in (calibration, held))
        apart = separations(exact, rounded) / URAD
    apart = np.where(np.isfinite(apart), apart, np.inf)
    worst = int(np.argmax(apart))
    return RoundingEffect(
        rms_urad=float(np.sqrt(np.mean(apart**2))),
        worst_urad=float(apart[worst]),
        at_row_px=float(m[worst]),
        at_col_px=float(n[worst]),
    )


def _star_vectors(calibration: Calibration, m: Floats, n: Floats) -> Floats:
    """Return s_s (S, 3), of unit length however C_SD was rounded."""
    s_s = calibration.camera.directions(m, n) @ calibration.c_sd.T
    return np.asarray(s_s / np.linalg.norm(s_s, axis=1, keepdims=True))


def rounding_refusals(effect: RoundingEffect, rms_urad: float | None, part: float) -> list[str]:
    """Return why the rounding costs too much, empty when it does not.

    ``part`` : largest angle allowed, as a part of the fit's RMS ``rms_urad``
    """
    if rms_urad is None or not 0.0 < rms_urad < np.inf:
        return [f"rounding: the RMS of the fit is {rms_urad}, there is nothing to judge it by"]
    limit = part * rms_urad
    if effect.worst_urad <= limit:
        return []
    return [
        f"rounding turns star vectors by up to {effect.worst_urad:.3g} urad (at row "
        f"{effect.at_row_px:g}, column {effect.at_col_px:g}; RMS {effect.rms_urad:.3g}), beyond "
        f"{limit:.3g} urad, {part:g} of the fit's RMS {rms_urad:.3g}"
    ]
