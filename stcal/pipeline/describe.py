"""Results as JSON documents, from which terminal tables and reports are made."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.calibration import Calibration
from stcal.constants import ARCSEC, URAD
from stcal.estimators.batch import Observability
from stcal.frames import Fragment
from stcal.matching import Matcher
from stcal.pipeline.cycles import Cycle, change_in_sd
from stcal.pipeline.estimate import Estimate, Solution
from stcal.pipeline.numbers import number, numbers
from stcal.pipeline.pieces import Piece
from stcal.pipeline.views import residual_views, series
from stcal.residuals import Residual
from stcal.times import format_utc
from stcal.units import unit_of
from stcal.version import __version__

Floats = NDArray[np.float64]

# A direction in parameter space is called weak when it is this much less observable.
_WEAK = 30.0


def header(schema: str, sensor_id: str) -> dict[str, Any]:
    """Return the fields that open every document."""
    return {
        "schema": schema,
        "sensor_id": sensor_id,
        "software": f"stcal {__version__}",
        "created_utc": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
    }


def span_of(fragments: Iterable[Fragment]) -> dict[str, Any]:
    """Return the first and the last time of the frames."""
    first, last = zip(*(fragment.span_tai_ns for fragment in fragments), strict=True)
    return {"from": format_utc(min(first)), "to": format_utc(max(last))}


def batch_document(
    estimate: Estimate,
    cycles: Sequence[Cycle],
    settled: bool,
    pieces: Sequence[Piece],
    initial: Calibration,
    matcher: Matcher,
    refusals: list[str],
    provenance: dict[str, Any],
    matches: str,
) -> dict[str, Any]:
    """Return the document of a batch fit, schema ``stcal.fit/1``."""
    rows = [_cycle(cycles, k, estimate.solution) for k in range(len(cycles))]
    return fit_document(estimate, pieces, initial, matcher, refusals, provenance) | {
        "method": "batch",
        "matches": matches,
        "cycles": rows,
        "settled": settled,
    }


def fit_document(
    estimate: Estimate,
    pieces: Sequence[Piece],
    initial: Calibration,
    matcher: Matcher,
    refusals: list[str],
    provenance: dict[str, Any],
) -> dict[str, Any]:
    """Return what the documents of all estimators share."""
    solution, observed = estimate.solution, estimate.observed
    before, after = estimate.baseline, solution.identified
    return {
        **header("stcal.fit/1", initial.sensor_id),
        "residual": _residual(solution.residual),
        "verdict": {
            "accepted": not refusals,
            "reasons": refusals,
            "notes": notes(before.without_velocity) + _residual_notes(solution.residual),
        },
        "frames": before.frames,
        "frames_solved": {"initial": before.frames_solved, "fitted": after.frames_solved},
        "matched_stars": {"initial": before.matched_stars, "fitted": after.matched_stars},
        "exposures_used": solution.kept.exposures,
        "stars_used": solution.kept.stars,
        "stars_rejected": solution.kept.rejected,
        "residuals": solution.information.rows,
        "residuals_dependent": solution.kept.dependent,
        "span": span_of(piece.fragment for piece in pieces),
        "parameters": _parameters(solution, initial, matcher),
        "estimated_parameters": solution.estimated_names,
        "covariance": numbers(solution.covariance),
        "correlation": numbers(_correlation(solution)),
        "condition": {
            "raw": number(observed.condition_raw),
            "scaled": number(observed.condition_scaled),
        },
        "singular_values": numbers(observed.singular_values),
        "singular_vectors": numbers(observed.singular_vectors),
        "observability": observability_sentence(observed, solution.estimated_names),
        "rms_urad": {
            "initial": number(estimate.rms_initial / URAD),
            "fitted": number(estimate.rms_fitted / URAD),
        },
        "noise": {"sd_px": matcher.config.noise.sd_px, "scale": number(solution.noise_scale)},
        "coverage": number(estimate.coverage),
        "c_sd": _alignment(estimate),
        **residual_views(estimate.figures.views, solution.camera),
        "series": series(
            before.series, after.series, ("matched_initial", "matched_fitted"),
            ("fix_initial", "fix_fitted"),
        ),
        "provenance": provenance,
    }  # fmt: skip


def _residual(residual: Residual) -> str:
    if residual.name != "singular-values":
        return residual.name
    used = ",".join(map(str, residual.values))
    return f"{residual.name}, groups {residual.groups}, values {used}"


def _residual_notes(residual: Residual) -> list[str]:
    """Return what the covariance leaves out."""
    if residual.name != "cosine":
        return []
    return [
        "cosines of pairs that share a star are taken as independent, as published: the sd are "
        "too small"
    ]


def notes(unknown: int) -> list[str]:
    """Return what a reader should know of frames without the spacecraft's velocity."""
    if not unknown:
        return []
    return [
        f"the spacecraft's velocity is unknown in {unknown} frames: in a low orbit it displaces "
        "stars by up to 25 urad, of which some 5 urad over the field are not a rotation"
    ]


def quality(document: dict[str, Any]) -> dict[str, Any]:
    """Return the part of a fit's document that the calibration file carries."""
    keys = ("method", "verdict", "frames", "exposures_used", "stars_used", "residual", "residuals",
            "rms_urad", "estimated_parameters", "noise", "coverage", "condition",
            "observability")  # fmt: skip
    alignment = {k: v for k, v in document["c_sd"].items() if k != "matrix"}
    return {key: document[key] for key in keys} | {"c_sd": alignment}


def _cycle(cycles: Sequence[Cycle], k: int, solution: Solution) -> dict[str, Any]:
    cycle = cycles[k]
    found, fitted = cycle.identified, cycle.fitted
    return {
        "cycle": k + 1,
        "matching": cycle.matching,
        "frames_solved": found.frames_solved,
        "exposures_solved": found.exposures_solved,
        "matched_stars": found.matched_stars,
        "matches_changed": found.changed,
        "iterations": fitted.solution.iterations,
        "converged": fitted.solution.converged,
        "rms_urad": number(cycle.rms / URAD),
        "chi2": number(fitted.solution.chi2),
        "stars_fitted": fitted.kept.stars,
        "dof": fitted.solution.information.rows - len(solution.free),
        "noise_scale": number(cycle.noise_scale),
        "stars_rejected": fitted.kept.rejected,
        "change_sd": number(change_in_sd(cycles, k, solution.covariance)),
    }


def _parameters(solution: Solution, initial: Calibration, matcher: Matcher) -> list[dict[str, Any]]:
    """Return one row per camera parameter; one that is held fixed has no sd."""
    camera = solution.camera
    sd = np.sqrt(np.diag(solution.covariance))
    sd[np.setdiff1d(np.arange(len(sd)), solution.free)] = np.nan
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


def _correlation(solution: Solution) -> Floats:
    """Return (K, K), of the estimated parameters."""
    covariance = solution.covariance[np.ix_(solution.free, solution.free)]
    sd = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(covariance / np.outer(sd, sd))


def observability_sentence(observed: Observability, names: Sequence[str]) -> str:
    """Say which combination of parameters the data determine worst."""
    values, vectors = observed.singular_values, observed.singular_vectors
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
        "frames_used": found.frames_used,
        "frames_rejected": found.frames_rejected,
    }
