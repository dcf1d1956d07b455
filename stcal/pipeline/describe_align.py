"""The document of an alignment, schema ``stcal.alignment/1``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from stcal.calibration import Calibration
from stcal.constants import ARCSEC, DEG, URAD
from stcal.estimators.misalignment import Misalignment
from stcal.frames import FrameBatch
from stcal.geometry.rotations import vector_from_matrix
from stcal.pipeline import describe
from stcal.pipeline.align_estimate import AlignEstimate
from stcal.pipeline.numbers import number, numbers
from stcal.pipeline.pairing import Paired
from stcal.times import format_utc_array

Floats = NDArray[np.float64]

SCHEMA = "stcal.alignment/1"
_CONFIDENCE = 0.95
_NOTED_SCALE = 1.5


def alignment_document(
    paired: Paired,
    estimate: AlignEstimate | None,
    method: str,
    reasons: list[str],
    batches: Sequence[FrameBatch],
    calibration: Calibration,
    body: dict[str, Any],
    provenance: dict[str, Any],
) -> dict[str, Any]:
    """Return the document; ``result`` is the estimate of ``method``, null when a gate refused."""
    methods = {} if estimate is None else _methods(estimate)
    without_velocity = sum(batch.without_velocity for batch in batches)
    return {
        **describe.header(SCHEMA, calibration.sensor_id),
        "verdict": {
            "accepted": not reasons,
            "reasons": reasons,
            "notes": describe.notes(without_velocity) + _noise_notes(estimate),
        },
        "method": method,
        "result": None if reasons else methods[method],
        "methods": methods,
        "body": body,
        "span": describe.span_of(batches),
        "frames": sum(b.n_frames for b in batches),
        "frames_identified": paired.usable_frames,
        "frames_with_attitude": len(paired.t_tai_ns),
        "stars_rejected": paired.stars_rejected,
        **({} if estimate is None else _agreement(estimate)),
        "history": {} if estimate is None else _history(estimate, paired),
        "calibration_serial": calibration.serial,
        "provenance": provenance,
    }


def _noise_notes(estimate: AlignEstimate | None) -> list[str]:
    """Say when the frames scatter far more than their noise: their weights are not the best."""
    if estimate is None or estimate.scale.max() < _NOTED_SCALE:
        return []
    return [
        f"the frames scatter {estimate.scale.max():.1f} times their noise: state the noise of the "
        f"body's attitude, which seems to have {attitude_excess_rad(estimate) / URAD:.0f} urad "
        "per axis beside the stated"
    ]


def _methods(estimate: AlignEstimate) -> dict[str, Any]:
    """Return every method's last estimate, and its departure from the multiplicative one."""
    reference = estimate.methods["multiplicative"].c_sb[-1]
    return {name: _last(found, reference) for name, found in estimate.methods.items()}


def _last(found: Misalignment, reference: Floats) -> dict[str, Any]:
    c_sb, covariance = found.c_sb[-1], found.covariance[-1]
    return {
        "c_sb": numbers(c_sb),
        # S relative to B, as the telemetry's quaternion is S relative to I.
        "q_sb": numbers(Rotation.from_matrix(c_sb.T).as_quat(canonical=True)),
        "angles_deg": dict(
            zip(("roll", "pitch", "yaw"), numbers(euler_angles(c_sb) / DEG), strict=True)
        ),
        "covariance_rad2": numbers(covariance),
        "sd_arcsec": numbers(np.sqrt(np.diag(covariance)) / ARCSEC),
        "from_multiplicative_arcsec": numbers(
            vector_from_matrix((c_sb @ reference.T)[None])[0] / ARCSEC
        ),
    }


def euler_angles(c_sb: Floats) -> Floats:
    """Return roll, pitch, yaw [rad] of c_sb (..., 3, 3) = R_x(roll) R_y(pitch) R_z(yaw).

    The R turn the axes: the sequence 3-2-1 from B to S, with which Zhang's matrix (52) is one
    degree about each axis.
    """
    roll = np.arctan2(c_sb[..., 1, 2], c_sb[..., 2, 2])
    pitch = -np.arcsin(np.clip(c_sb[..., 0, 2], -1.0, 1.0))
    yaw = np.arctan2(c_sb[..., 0, 1], c_sb[..., 0, 0])
    return np.stack([roll, pitch, yaw], axis=-1)


def _agreement(estimate: AlignEstimate) -> dict[str, Any]:
    found, frames = estimate.innovations, estimate.sightings.n_frames
    tail = 0.5 * (1.0 - _CONFIDENCE)
    bounds = np.asarray(chi2.ppf([tail, 1.0 - tail], 3 * (frames - 1))) / frames
    return {
        "frames_used": frames,
        "frames_rejected": int((~estimate.kept).sum()),
        "stars_used": len(estimate.sightings.sd),
        "rms_residual_urad": number(_rms_residual(estimate) / URAD),
        "nis": {
            "mean": number(found.nis.mean()),
            "expected": 3.0 * (1.0 - 1.0 / frames),
            "interval": numbers(bounds),
            "confidence": _CONFIDENCE,
        },
        "noise": {
            "stars": number(estimate.star_scale),
            "frames": numbers(estimate.scale),
            "correlation": numbers(estimate.correlation),
            "attitude_excess_urad": number(attitude_excess_rad(estimate) / URAD),
        },
    }


def _rms_residual(estimate: AlignEstimate) -> float:
    """RMS angle [rad] between measured and predicted star vectors."""
    sightings, c_sb = estimate.sightings, estimate.methods["multiplicative"].c_sb[-1]
    difference = sightings.s_s - sightings.s_b @ c_sb.T
    return float(np.sqrt((difference**2).sum(axis=1).mean()))


def attitude_excess_rad(estimate: AlignEstimate) -> float:
    """Return the sd per axis of body attitude noise that would explain the frames' scatter.

    Beside the noise that was stated; the mean square excess, weighted as a variance is.
    """
    rotation = estimate.innovations.rotation
    variance = np.diagonal(estimate.innovations.covariance, axis1=1, axis2=2)
    excess = np.average(rotation**2 - variance, weights=variance**-2.0)
    return float(np.sqrt(max(excess, 0.0)))


def _history(estimate: AlignEstimate, paired: Paired) -> dict[str, Any]:
    """Return every method's estimates over time, as departures from its last one."""
    used = paired.t_tai_ns[estimate.kept]
    times = used[estimate.stops - 1]
    return {
        "time_utc": format_utc_array(times).tolist(),
        "elapsed_s": numbers((times - used[0]) * 1e-9),
        "frames": estimate.stops.tolist(),
        **{name: _steps(found) for name, found in estimate.methods.items()},
    }


def _steps(found: Misalignment) -> dict[str, Any]:
    departure = vector_from_matrix(found.c_sb @ found.c_sb[-1].T)
    sd = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    return {
        "angles_deg": numbers(euler_angles(found.c_sb) / DEG),
        "departure_arcsec": numbers(departure / ARCSEC),
        "sd_arcsec": numbers(sd / ARCSEC),
    }
