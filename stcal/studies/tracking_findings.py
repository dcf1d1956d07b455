"""What the study ``tracking`` finds: what filters should do, decided from its numbers alone."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.report.format import fixed, percent
from stcal.studies import tracking_claims as claims
from stcal.studies.findings import FAILS, HOLDS, OPEN, PARTLY, Document, number_at

Floats = NDArray[np.float64]

# An estimate follows when the truth lies within 3 sd in so many frames (97 %: neighbouring errors
# are alike, so a run holds some 200 independent ones), and does not when in fewer than half.
_FOLLOWS, _LOST = 0.97, 0.5
# A band is as wide as it should be when these hold: 68.3 % expected, and 1.
_WITHIN_1SD, _RMS_Z = (0.58, 0.78), (0.85, 1.15)
# The common-pair RMS of an estimate that does not follow is higher by so much, at least.
_HIGHER = 1.05
# A step is followed within so many frames.
_BACK_FRAMES = 50


def findings(document: Document) -> list[dict[str, str]]:
    """Return the findings of a study's document."""
    drift, step = document["cases"]["drift"], document["cases"]["step"]
    return [
        _following(drift),
        _honest(drift),
        _lost_track(drift),
        _width(drift),
        _thermal(drift),
        _evidence(document["temperature"]),
        _step(step),
        _ignorance(drift, step),
        _watch(document["cases"]),
    ]


def _moving(case: Document, variant: str, key: str) -> Floats:
    """Return a figure of the parameters that move, NaN where it is missing."""
    found = case["variants"].get(variant, {})
    return np.array([number_at(found, "parameters", name, key) for name in case["moving"]])


def _figure(case: Document, variant: str, key: str) -> float:
    """Return a figure of the focal length."""
    return number_at(case["variants"].get(variant, {}), "parameters", "f_m", key)


def _verdict(holds: bool, partly: bool = False) -> str:
    return HOLDS if holds else PARTLY if partly else FAILS


def _following(drift: Document) -> dict[str, str]:
    share, part = _figure(drift, "q", "within_3sd"), _part(drift, "q")
    here = (
        f"Within 3 sd in {percent(share)} of the frames after the first {drift['settled_frames']}; "
        f"rms error {_microns(_figure(drift, 'q', 'rms'))}; {percent(part)} of the variation "
        f"followed, {_lag(drift, 'q')} late; common-pair RMS "
        f"{_ratio(drift, 'q')} times that of the true camera."
    )
    return claims.FOLLOWING.judged(_verdict(share >= _FOLLOWS and part > 0.9), here)


def _honest(drift: Document) -> dict[str, str]:
    share, z = _figure(drift, "q", "within_1sd"), _figure(drift, "q", "rms_z")
    here = f"Within 1 sd in {percent(share)} of the frames; rms of error / sd {fixed(z, 2)}."
    inside = (_WITHIN_1SD[0] <= share <= _WITHIN_1SD[1], _RMS_Z[0] <= z <= _RMS_Z[1])
    return claims.HONEST.judged(_verdict(all(inside), any(inside)), here)


def _lost_track(drift: Document) -> dict[str, str]:
    share, ratio = _figure(drift, "no_q", "within_3sd"), number_at(drift, "variants", "no_q",
                                                                   "rms_ratio")  # fmt: skip
    here = (
        f"Within 3 sd in {percent(share)} of the frames; rms error "
        f"{_microns(_figure(drift, 'no_q', 'rms'))}; {percent(_part(drift, 'no_q'))} of "
        f"the variation followed; common-pair RMS {_ratio(drift, 'no_q')} times that of the true "
        "camera."
    )
    return claims.LOST_TRACK.judged(_verdict(share < _LOST and ratio > _HIGHER), here)


def _width(drift: Document) -> dict[str, str]:
    less, chosen, more = (
        _figure(drift, variant, "rms") for variant in ("q_third", "q", "q_triple")
    )
    widths = [_figure(drift, variant, "rms_z") for variant in ("q_third", "q", "q_triple")]
    here = (
        f"Rms error of the focal length at 1/3, 1 and 3 times the process noise: {_microns(less)}, "
        f"{_microns(chosen)}, {_microns(more)}; rms of error / sd "
        f"{', '.join(fixed(z, 2) for z in widths)}."
    )
    worse = (less > chosen, more > chosen)
    return claims.WIDTH.judged(_verdict(all(worse), any(worse)), here)


def _thermal(drift: Document) -> dict[str, str]:
    walks = ("q_third", "q", "q_triple", "q_all")
    error, share = _figure(drift, "thermal", "rms"), _figure(drift, "thermal", "within_3sd")
    here = (
        f"Rms error {_microns(error)}, against {_microns(_figure(drift, 'q', 'rms'))} of the walk; "
        f"{_lag(drift, 'thermal')} late, against {_lag(drift, 'q')}; within 3 sd in "
        f"{percent(share)} of the frames; common-pair RMS {_ratio(drift, 'thermal')} times that of "
        "the true camera."
    )
    better = error < min(_figure(drift, walk, "rms") for walk in walks)
    return claims.THERMAL.judged(_verdict(better and share >= _FOLLOWS, better), here)


def _evidence(temperature: Document) -> dict[str, str]:
    chosen, evidence = {}, {}
    for name, case in temperature.items():
        chosen[name] = np.array([decision["chosen"] is True for decision in case["decisions"]])
        values = [number_at(decision, "twice_log_evidence") for decision in case["decisions"]]
        evidence[name] = ", ".join(fixed(value, 1) for value in values)
    here = (
        f"Twice the log Bayes factor on the drift: {evidence['drift']} (chosen in "
        f"{int(chosen['drift'].sum())} of {len(chosen['drift'])} runs); on the constant camera: "
        f"{evidence['constant']} (chosen in {int(chosen['constant'].sum())} of "
        f"{len(chosen['constant'])})."
    )
    right = bool(chosen["drift"].all() and not chosen["constant"].any())
    return claims.EVIDENCE.judged(_verdict(right), here)


def _step(step: Document) -> dict[str, str]:
    back, never = (_back(step, variant) for variant in ("q", "no_q"))
    here = (
        f"Frames until within 3 sd, with process noise: {_named_frames(step, 'q')}; without: "
        f"{_named_frames(step, 'no_q')}. Common-pair RMS {_ratio(step, 'q')} and "
        f"{_ratio(step, 'no_q')} times that of the true camera."
    )
    returns, lost = bool((back <= _BACK_FRAMES).all()), bool(np.isnan(never).all())
    return claims.STEP.judged(_verdict(returns and lost, returns or lost), here)


def _ignorance(drift: Document, step: Document) -> dict[str, str]:
    shares = np.concatenate([_moving(case, "q_all", "within_3sd") for case in (drift, step)])
    errors = [_figure(case, "q_all", "rms") / _figure(case, "q", "rms") for case in (drift, step)]
    here = (
        f"Focal length within 3 sd in {percent(_figure(drift, 'q_all', 'within_3sd'))} (drift) and "
        f"{percent(_figure(step, 'q_all', 'within_3sd'))} (step) of the frames, rms error "
        f"{fixed(errors[0], 1)} and {fixed(errors[1], 1)} times that of a walk of what moves; "
        f"common-pair RMS {_ratio(drift, 'q_all')} and {_ratio(step, 'q_all')} times that of the "
        "true camera."
    )
    follows, costs = bool((shares >= _FOLLOWS).all()), min(errors) > 1.0
    return claims.IGNORANCE.judged(_verdict(follows and costs, follows or costs), here)


def _watch(cases: Document) -> dict[str, str]:
    counts = {
        f"{name}, {variant}": int(found["fallbacks"])
        for name, case in cases.items()
        for variant, found in case["variants"].items()
    }
    fell = [f"{name}: {count}" for name, count in counts.items() if count]
    here = f"{len(counts)} variants, {sum(counts.values())} fallbacks" + (
        f" ({'; '.join(fell)})." if fell else "."
    )
    return claims.WATCH.judged(_verdict(not fell), here)


def _part(case: Document, variant: str) -> float:
    """Return which part of the focal length's variation a variant follows."""
    return number_at(case, "variants", variant, "following", "f_m", "part")


def _lag(case: Document, variant: str) -> str:
    """Return by how much the focal length is late, averaged over the runs."""
    runs = case["variants"][variant]["following"]["f_m"]["lag_s"]
    return fixed(float(np.mean(np.array(runs, dtype=np.float64))), 0, "s")


def _ratio(case: Document, variant: str) -> str:
    return fixed(number_at(case, "variants", variant, "rms_ratio"), 3)


def _microns(value: float) -> str:
    return fixed(1e6 * value, 2, "µm")


def _back(case: Document, variant: str) -> Floats:
    """Return frames until the estimate is back (parameters and runs), NaN for never."""
    found: dict[str, Any] = case["variants"][variant]["back_after"]
    return np.array([value for runs in found.values() for value in runs], dtype=np.float64)


def _named_frames(case: Document, variant: str) -> str:
    parts = []
    for name, runs in case["variants"][variant]["back_after"].items():
        shown = sorted({"never" if value is None else str(value) for value in runs})
        parts.append(f"{name.split('_')[0]} {', '.join(shown)}")
    return "; ".join(parts) or OPEN
