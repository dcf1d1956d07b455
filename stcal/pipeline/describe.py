"""Results as JSON documents, from which terminal tables and reports are made."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stcal.calibration import Calibration
from stcal.cameras import Camera
from stcal.constants import ARCSEC, URAD
from stcal.frames import FrameBatch, MatchedFrames
from stcal.matching import Matcher
from stcal.metrics import cell_of, detector_cells, residual_vectors
from stcal.pipeline.cycles import Cycle
from stcal.residuals.selection import StarSelection
from stcal.times import format_utc
from stcal.units import unit_of
from stcal.version import __version__

if TYPE_CHECKING:
    from stcal.pipeline.fit import Estimate

Floats = NDArray[np.float64]

_SERIES_LENGTH = 1500
_RADIAL_BINS = 12
# A direction in parameter space is called weak when it is this much less observable.
_WEAK = 30.0


def number(value: float) -> float | None:
    """Return a float that JSON can hold: None for NaN and infinity."""
    return float(value) if math.isfinite(value) else None


def numbers(values: NDArray[np.floating] | Sequence[float]) -> list[Any]:
    """Return nested lists of JSON numbers."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim > 1:
        return [numbers(row) for row in array]
    return [number(v) for v in array]


def header(schema: str, sensor_id: str) -> dict[str, Any]:
    """Return the fields that open every document."""
    return {
        "schema": schema,
        "sensor_id": sensor_id,
        "software": f"stcal {__version__}",
        "created_utc": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
    }


def span_of(batches: Sequence[FrameBatch]) -> dict[str, Any]:
    """Return the first and the last time of the frames."""
    first = min(int(b.t_tai_ns.min()) for b in batches)
    last = max(int(b.t_tai_ns.max()) for b in batches)
    return {"from": format_utc(first), "to": format_utc(last)}


def fit_document(
    estimate: Estimate,
    batches: Sequence[FrameBatch],
    initial: Calibration,
    matcher: Matcher,
    refusals: list[str],
    provenance: dict[str, Any],
    matches: str,
) -> dict[str, Any]:
    """Return the document of a fit, schema ``stcal.fit/1``."""
    last = estimate.last
    observed = estimate.observed
    selections = [bound.selection for bound in last.bound]
    return {
        **header("stcal.fit/1", initial.sensor_id),
        "method": "batch",
        "residual": "arclength",
        "matches": matches,
        "verdict": {"accepted": not refusals, "reasons": refusals, "notes": notes(batches)},
        "frames": sum(b.n_frames for b in batches),
        "frames_solved": {
            "initial": sum(int(m.frame_solved.sum()) for m in estimate.baseline),
            "fitted": sum(int(m.frame_solved.sum()) for m in last.matched),
        },
        "matched_stars": {
            "initial": sum(int(m.is_matched.sum()) for m in estimate.baseline),
            "fitted": last.matched_stars,
        },
        "exposures_used": sum(s.n_exposures for s in selections),
        "stars_used": sum(len(s.star) for s in selections),
        "arcs": last.solution.information.rows,
        "arcs_dependent": sum(b.dependent for b in last.bound),
        "span": span_of(batches),
        "cycles": [_cycle(estimate.cycles, k, estimate) for k in range(len(estimate.cycles))],
        "settled": estimate.settled,
        "parameters": _parameters(estimate, initial, matcher),
        "covariance": numbers(estimate.covariance),
        "correlation": numbers(_correlation(estimate.covariance)),
        "condition": {
            "raw": number(observed.condition_raw),
            "scaled": number(observed.condition_scaled),
        },
        "singular_values": numbers(observed.singular_values),
        "singular_vectors": numbers(observed.singular_vectors),
        "observability": observability_sentence(estimate, last.camera.parameter_names),
        "rms_urad": {
            "initial": number(estimate.rms_initial / URAD),
            "fitted": number(estimate.rms_fitted / URAD),
        },
        "noise": {"sd_px": matcher.config.noise.sd_px, "scale": number(last.noise_scale)},
        "coverage": number(estimate.coverage),
        "c_sd": _alignment(estimate),
        **residual_views(selections, initial.camera, last.camera),
        "series": series(
            estimate.baseline, last.matched, ("matched_initial", "matched_fitted"),
            ("fix_initial", "fix_fitted"),
        ),
        "provenance": provenance,
    }  # fmt: skip


def notes(batches: Sequence[FrameBatch]) -> list[str]:
    """Return what a reader of the result should know about the telemetry."""
    unknown = sum(int((~np.isfinite(b.vel_km_s).all(axis=1)).sum()) for b in batches)
    if not unknown:
        return []
    return [
        f"the spacecraft's velocity is unknown in {unknown} frames: in a low orbit it displaces "
        "stars by up to 25 urad, of which some 5 urad over the field are not a rotation"
    ]


def quality(document: dict[str, Any]) -> dict[str, Any]:
    """Return the part of a fit's document that the calibration file carries."""
    keys = ("verdict", "frames", "exposures_used", "stars_used", "arcs", "settled", "rms_urad",
            "noise", "coverage", "condition", "observability")  # fmt: skip
    alignment = {k: v for k, v in document["c_sd"].items() if k != "matrix"}
    return {key: document[key] for key in keys} | {"c_sd": alignment}


def _cycle(cycles: Sequence[Cycle], k: int, estimate: Estimate) -> dict[str, Any]:
    cycle = cycles[k]
    before = cycles[k - 1].camera.parameters if k else None
    sd = np.sqrt(np.diag(estimate.covariance))
    moved = None
    if before is not None and np.isfinite(sd).all():
        moved = number(float(np.max(np.abs(cycle.camera.parameters - before) / sd)))
    squares = sum(float((b.departures(cycle.camera) ** 2).sum()) for b in cycle.bound)
    arcs = sum(len(b.arc) for b in cycle.bound)
    return {
        "cycle": k + 1,
        "matching": cycle.matching,
        "frames_solved": sum(int(m.frame_solved.sum()) for m in cycle.matched),
        "exposures_solved": sum(int(m.solved.sum()) for m in cycle.matched),
        "matched_stars": cycle.matched_stars,
        "matches_changed": cycle.changed,
        "iterations": cycle.solution.iterations,
        "converged": cycle.solution.converged,
        "rms_urad": number(math.sqrt(squares / arcs) / URAD) if arcs else None,
        "chi2": number(cycle.solution.chi2),
        "dof": cycle.solution.information.rows - len(cycle.camera.parameters),
        "noise_scale": number(cycle.noise_scale),
        "stars_rejected": cycle.rejected,
        "change_sd": moved,
    }


def _parameters(estimate: Estimate, initial: Calibration, matcher: Matcher) -> list[dict[str, Any]]:
    camera = estimate.last.camera
    sd = np.sqrt(np.diag(estimate.covariance))
    rows = []
    for k, name in enumerate(camera.parameter_names):
        change = float(camera.parameters[k] - initial.camera.parameters[k])
        sigma = matcher.config.camera.scale[name].sigma
        rows.append(
            {
                "name": name,
                "initial": number(initial.camera.parameters[k]),
                "fitted": number(camera.parameters[k]),
                "sd": number(sd[k]),
                "change": number(change),
                "change_sigma": number(change / sigma),
                "change_sd": number(change / sd[k]) if sd[k] > 0 else None,
                "sigma": sigma,
            }
        )
    return rows


def _correlation(covariance: Floats) -> Floats:
    sd = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(covariance / np.outer(sd, sd))


def observability_sentence(estimate: Estimate, names: Sequence[str]) -> str:
    """Say which combination of parameters the data determine worst."""
    values, vectors = estimate.observed.singular_values, estimate.observed.singular_vectors
    if not values[-1] > 0:
        return "At least one combination of parameters is not observable at all."
    weak = [k for k in range(len(values)) if values[0] / values[k] > _WEAK]
    if not weak:
        return (
            "Every combination of parameters is well observable: the weakest is "
            f"{values[0] / values[-1]:.0f} times weaker than the strongest."
        )
    parts = [
        f"{_combination(vectors[:, k], names)} ({values[0] / values[k]:.0f} times weaker than the "
        "best determined combination)"
        for k in reversed(weak[-2:])
    ]
    return (
        "Weakly observable, parameters in units of their sigma: " + ", then ".join(parts) + ". "
        "Along such a combination parameters may move together almost without changing the "
        "residuals, so their values must be read with the correlations."
    )


def _combination(vector: Floats, names: Sequence[str]) -> str:
    parts = [k for k in np.argsort(-np.abs(vector)) if abs(vector[k]) > 0.25]
    return " ".join(f"{vector[k]:+.2f} {unit_of(names[k]).symbol}" for k in parts)


def _alignment(estimate: Estimate) -> dict[str, Any]:
    found = estimate.alignment
    if found is None:
        return {}
    return {
        "matrix": numbers(found.c_sd),
        "offset_arcsec": numbers(found.offset / ARCSEC),
        "spread_arcsec": numbers(found.spread / ARCSEC),
        "sd_of_mean_arcsec": numbers(found.sd_of_mean / ARCSEC),
        "exposures_used": found.exposures_used,
        "exposures_rejected": found.exposures_rejected,
    }


def residual_views(
    selections: Sequence[StarSelection], before: Camera, after: Camera
) -> dict[str, Any]:
    """Return the residual field by detector cell and its radial profile, under two cameras."""
    row, col = (
        np.concatenate([getattr(s, name) for s in selections]) for name in ("row_px", "col_px")
    )
    vectors = [
        np.concatenate([residual_vectors(s, c) for s in selections]) for c in (before, after)
    ]
    good = np.isfinite(vectors[0]).all(axis=1) & np.isfinite(vectors[1]).all(axis=1)
    row, col, old, new = row[good], col[good], vectors[0][good], vectors[1][good]
    return {
        "field": _field(row, col, old, new, after),
        "radial": _radial(row, col, old, new, after),
    }


def _field(row: Floats, col: Floats, old: Floats, new: Floats, camera: Camera) -> dict[str, Any]:
    cells = detector_cells(camera.rows, camera.cols)
    cell = cell_of(row, col, camera, cells)
    size = cells[0] * cells[1]
    count = np.bincount(cell, minlength=size)
    used = np.flatnonzero(count)

    def mean(values: Floats) -> list[Any]:
        return numbers((np.bincount(cell, values, minlength=size) / np.maximum(count, 1))[used])

    i, j = np.divmod(used, cells[1])
    return {
        "rows": camera.rows,
        "cols": camera.cols,
        "row_px": numbers((i + 0.5) * camera.rows / cells[0] - 0.5),
        "col_px": numbers((j + 0.5) * camera.cols / cells[1] - 0.5),
        "count": count[used].tolist(),
        "before_row_px": mean(old[:, 0]),
        "before_col_px": mean(old[:, 1]),
        "after_row_px": mean(new[:, 0]),
        "after_col_px": mean(new[:, 1]),
    }


def _radial(row: Floats, col: Floats, old: Floats, new: Floats, camera: Camera) -> dict[str, Any]:
    """Mean radial component of the residuals over the distance from the detector's centre."""
    y, x = row - 0.5 * (camera.rows - 1), col - 0.5 * (camera.cols - 1)
    radius = np.hypot(x, y)
    unit = np.stack([y, x], axis=1) / np.maximum(radius, 1e-9)[:, None]
    edge = 0.5 * math.hypot(camera.rows, camera.cols) / _RADIAL_BINS
    which = np.minimum((radius / edge).astype(int), _RADIAL_BINS - 1)
    count = np.bincount(which, minlength=_RADIAL_BINS)
    used = np.flatnonzero(count >= 3)

    def mean(values: Floats) -> Floats:
        return np.bincount(which, values, minlength=_RADIAL_BINS) / np.maximum(count, 1)

    along_old, along_new = (old * unit).sum(axis=1), (new * unit).sum(axis=1)
    centre = mean(along_new)
    variance = mean((along_new - centre[which]) ** 2)
    return {
        "radius_px": numbers((used + 0.5) * edge),
        "before_px": numbers(mean(along_old)[used]),
        "after_px": numbers(centre[used]),
        "sd_after_px": numbers(np.sqrt(variance)[used]),
        "count": count[used].tolist(),
    }


def series(
    before: Sequence[MatchedFrames],
    after: Sequence[MatchedFrames],
    counts: tuple[str, str],
    fixes: tuple[str, str],
) -> dict[str, Any]:
    """Return matched stars (both exposures) and fixes over time, thinned for plotting."""
    times = np.concatenate([m.frames.t_tai_ns for m in before])
    step = max(1, math.ceil(len(times) / _SERIES_LENGTH))
    document: dict[str, Any] = {"time_utc": [format_utc(int(t)) for t in times[::step]]}
    for name, matched in zip(counts, (before, after), strict=True):
        per_frame = [m.matches_per_exposure.reshape(-1, 2).sum(axis=1) for m in matched]
        document[name] = np.concatenate(per_frame)[::step].tolist()
    for name, matched in zip(fixes, (before, after), strict=True):
        document[name] = np.concatenate([m.frame_solved for m in matched])[::step].tolist()
    return document
