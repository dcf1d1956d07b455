"""The document of a sequential fit: what all fits share, and what the filter did."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from stcal.calibration import Calibration
from stcal.matching import Matcher
from stcal.pipeline.describe import fit_document
from stcal.pipeline.estimate import Estimate, Solution
from stcal.pipeline.evidence import twice_log_evidence
from stcal.pipeline.filter_run import EVENTS, FrameHistory, Run
from stcal.pipeline.filtering import Filter, Variant
from stcal.pipeline.numbers import number, numbers
from stcal.pipeline.parameters import parameter_scale
from stcal.pipeline.pieces import Piece
from stcal.times import format_utc

Floats = NDArray[np.float64]

_SERIES_LENGTH = 600
_CONFIDENCE = 0.95
# Farther from the optimum than this, a filter of constants has not found it.
_FAR_SD = 3.0


def sequential_document(
    estimate: Estimate,
    runs: dict[str, Run],
    choice: str,
    pieces: Sequence[Piece],
    initial: Calibration,
    matcher: Matcher,
    refusals: list[str],
    provenance: dict[str, Any],
    variant: Variant,
) -> dict[str, Any]:
    """Return the document of a sequential fit, schema ``stcal.fit/1``."""
    run = runs[choice]
    document = fit_document(estimate, pieces, initial, matcher, refusals, provenance)
    step = step_to_optimum_sd(estimate.solution, matcher)
    constant = not any((variant.process_noise or {}).values()) and choice == "constant"
    if constant and not step <= _FAR_SD:
        document["verdict"]["notes"].append(
            f"the estimate is {step:.1f} sd from the least squares optimum of all frames as they "
            "match now: its sd is too small, or it was made of other matches"
        )
    return document | {
        "method": f"sequential {variant.method}",
        "matches": variant.matches if variant.rematch else f"{variant.matches}, baseline only",
        "sequential": {
            "variant": asdict(variant),
            "frames": len(run.history.frame_id),
            "frames_updated": int((run.history.arcs > 0).sum()),
            "innovations": innovation_summary(run.history),
            "availability": _shares(run.history, "fixed"),
            "matched_stars": {
                "estimate": int(run.history.matched.sum()),
                "baseline": int(run.history.matched_baseline.sum()),
            },
            "stars_rejected": int(run.history.rejected.sum()),
            "step_to_optimum_sd": number(step),
            "linearised_anew": int(run.history.iterations.sum()),
            "events": _events(run.history),
            "on_baseline": bool(run.history.on_baseline[-1]),
            "temperature": _temperature(runs, choice, matcher),
            "history": history_series(run),
        },
    }


def step_to_optimum_sd(solution: Solution, matcher: Matcher) -> float:
    """Return the largest change, in sd, that one Gauss-Newton step over all frames would make."""
    scale = parameter_scale(matcher.config, solution.estimated_names)
    sd = np.sqrt(np.diag(solution.covariance))[solution.free]
    root, projected = solution.information.root, solution.information.projected
    step = np.linalg.lstsq(root, -projected, rcond=None)[0] * scale
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.abs(step / sd).max())


def innovation_summary(history: FrameHistory) -> dict[str, Any]:
    """Return how the innovations agree with their covariance (NIS), as one number and by frame.

    ``per_arc`` is the mean square of the standardised innovations under the configured noise;
    ``scaled_per_arc`` under the noise that the filter has found; ``within`` the share of frames
    whose NIS lies in its chi-square interval; ``lag_one`` the correlation of neighbours.
    """
    used = (history.arcs > 0) & np.isfinite(history.nis)
    nis, arcs = history.nis[used], history.arcs[used]
    if not len(nis):
        return {}
    scale2 = history.noise_scale[-1] ** 2
    tail = 0.5 * (1.0 - _CONFIDENCE)
    low, high = chi2.ppf(tail, arcs), chi2.ppf(1.0 - tail, arcs)
    inside = (nis / scale2 >= low) & (nis / scale2 <= high)
    z = history.innovation[np.isfinite(history.innovation)]
    lag = float((z[1:] * z[:-1]).sum() / max((z * z).sum(), 1e-300))
    return {
        "count": int(arcs.sum()),
        "per_arc": number(float(nis.sum() / arcs.sum())),
        "scaled_per_arc": number(float(nis.sum() / arcs.sum() / scale2)),
        "noise_scale": number(math.sqrt(scale2)),
        "confidence": _CONFIDENCE,
        "within": number(float(inside.mean())),
        "lag_one": number(lag),
    }


def _shares(history: FrameHistory, name: str) -> dict[str, Any]:
    own, baseline = getattr(history, name), getattr(history, f"{name}_baseline")
    used = np.where(history.on_baseline, baseline, own)
    found = {"estimate": own, "baseline": baseline, "used": used}
    return {key: number(float(value.mean())) for key, value in found.items()}


def _events(history: FrameHistory) -> list[dict[str, Any]]:
    return [
        {
            "frame_id": int(history.frame_id[f]),
            "time_utc": format_utc(int(history.t_tai_ns[f])),
            "event": EVENTS[history.event[f]],
        }
        for f in np.flatnonzero(history.event)
    ]


def _temperature(runs: dict[str, Run], choice: str, matcher: Matcher) -> dict[str, Any] | None:
    """Return the decision on parameters linear in temperature; None where it was not asked for."""
    if "thermal" not in runs:
        return None
    run, needed = runs["thermal"], matcher.config.sequential.temperature_evidence
    known = np.isfinite(run.history.temperature_c)
    slopes, sd = slopes_of(run.filter, run.state.x, run.filter.covariance(run.state))
    return {
        "reference_c": run.filter.reference_temperature_c,
        "range_c": numbers(np.percentile(run.history.temperature_c[known], [0, 100]))
        if known.any()
        else None,
        "frames_without": int((~known).sum()),
        "twice_log_evidence": number(twice_log_evidence(runs)),
        "needed": needed,
        "chosen": choice == "thermal",
        "slopes_per_k": {
            name: {"value": number(value), "sd": number(spread)}
            for name, value, spread in zip(thermal_names(run.filter), slopes, sd, strict=True)
        },
    }


def thermal_names(chosen: Filter) -> list[str]:
    """Return the names of the parameters that may depend on the temperature."""
    return [chosen.names[k] for k in np.flatnonzero(chosen.model.thermal)]


def slopes_of(chosen: Filter, x: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Return slopes per kelvin and their sd, in the parameters' own units."""
    where = np.flatnonzero(chosen.model.thermal)
    scale = chosen.model.scale[where]
    return x[where] * scale, np.sqrt(np.diag(covariance))[where] * scale


def history_series(run: Run) -> dict[str, Any]:
    """Return parameters, sd, NIS and matches over time, thinned for plotting.

    Parameters are those at the reference temperature, in their own units.
    """
    history, chosen = run.history, run.filter
    step = max(1, math.ceil(len(history.frame_id) / _SERIES_LENGTH))
    frames = np.unique(np.append(np.arange(0, len(history.frame_id), step),
                                 len(history.frame_id) - 1))  # fmt: skip
    parameters, where = chosen.parameters(history.x[frames]), chosen.constants
    target = chosen.model.target[where]
    with np.errstate(invalid="ignore"):
        nis = history.nis[frames] / np.maximum(history.arcs[frames], 1)
    return {
        "time_utc": [format_utc(int(t)) for t in history.t_tai_ns[frames]],
        "frame_id": history.frame_id[frames].tolist(),
        "parameters": {
            chosen.names[w]: {
                "value": numbers(parameters[:, p]),
                "sd": numbers(history.sd[frames, w] * chosen.model.scale[w]),
            }
            for w, p in zip(where, target, strict=True)
        },
        "nis_per_arc": numbers(nis),
        "arcs": history.arcs[frames].tolist(),
        "noise_scale": numbers(history.noise_scale[frames]),
        "matched": history.matched[frames].tolist(),
        "matched_baseline": history.matched_baseline[frames].tolist(),
        "on_baseline": history.on_baseline[frames].tolist(),
    }
