"""Stage ``validate``: two calibrations on held-out telemetry, Enright 2018 II-B and III."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.attitude import MeanRotation
from stcal.calibration import Calibration
from stcal.constants import ARCSEC, EXPOSURES_PER_FRAME, URAD
from stcal.execution import OrderedMap, serial
from stcal.frames import FrameBatch, MatchedFrames
from stcal.geometry.rotations import vector_from_matrix
from stcal.matching import Matcher, match
from stcal.metrics import (
    MARGINS,
    Interval,
    PairSums,
    bootstrap,
    difference,
    pair_sums,
    ratio,
    root_loss,
    root_ratio,
)
from stcal.pipeline import describe
from stcal.pipeline.alignment import attitude_change
from stcal.pipeline.fit import check_calibration
from stcal.pipeline.numbers import number, numbers
from stcal.pipeline.views import residual_views, series
from stcal.residuals import BoundArclength, bind_arclength, select_stars

Floats = NDArray[np.float64]

SCHEMA = "stcal.validation/1"
CONFIDENCE = 0.95
_JUMP_SD = 3.0


@dataclass(frozen=True)
class Comparison:
    """Per-frame sums of both calibrations (baseline first) on the same frames."""

    matched: tuple[list[MatchedFrames], list[MatchedFrames]]
    counted: NDArray[np.bool_]
    fixed: tuple[Floats, Floats]
    stars: tuple[Floats, Floats]
    pairs_from: str
    bound: list[BoundArclength]
    sums: tuple[PairSums, PairSums]


def validate(
    batches: Sequence[FrameBatch],
    baseline: Calibration,
    candidate: Calibration,
    matcher: Matcher,
    hashes: dict[str, str],
    method: str = "lost-in-space",
    mapper: OrderedMap = serial,
) -> dict[str, Any]:
    """Compare two calibrations on telemetry that neither was fitted to.

    Returns the document ``stcal.validation/1``; ``hashes`` are the SHA-256 of the two files under
    ``baseline`` and ``candidate`` and those of telemetry, catalogue and configuration.
    """
    batches = [batch for batch in batches if batch.n_frames]
    for calibration in (baseline, candidate):
        check_calibration(calibration, matcher.config, batches[0].sensor_id)
    compared = compare(batches, baseline, candidate, matcher, method, mapper)
    return _document(compared, batches, baseline, candidate, matcher, hashes, method)


def compare(
    batches: Sequence[FrameBatch],
    baseline: Calibration,
    candidate: Calibration,
    matcher: Matcher,
    method: str = "lost-in-space",
    mapper: OrderedMap = serial,
) -> Comparison:
    """Rematch the frames with both calibrations and sum what the metrics need, frame by frame."""
    counted = np.concatenate([b.counts_for_availability for b in batches])
    old, new = (
        list(
            mapper(
                partial(match, camera=c.camera, c_sd=c.c_sd, matcher=matcher, method=method),
                batches,
            )
        )
        for c in (baseline, candidate)
    )
    bounds = [_bind(matched, c, matcher) for matched, c in ((old, baseline), (new, candidate))]
    # Section II-B: common pairs are the largest set of star pairs available.
    under_baseline = [
        _sums(bound, matched, baseline, counted)
        for bound, matched in zip(bounds, (old, new), strict=True)
    ]
    chosen = 0 if under_baseline[0].pairs.sum() > under_baseline[1].pairs.sum() else 1
    larger, matched = bounds[chosen], (old, new)[chosen]
    return Comparison(
        matched=(old, new),
        counted=counted,
        fixed=(_fixed(old), _fixed(new)),
        stars=(_stars(old), _stars(new)),
        pairs_from=("baseline", "candidate")[chosen],
        bound=larger,
        sums=(
            under_baseline[chosen],
            _sums(larger, matched, candidate, counted),
        ),
    )


def _bind(
    matched: Sequence[MatchedFrames], calibration: Calibration, matcher: Matcher
) -> list[BoundArclength]:
    """Return the star pairs of every solved exposure by the 2 N - 3 rule."""
    noise, minimum = matcher.config.noise, matcher.config.fit.minimum_stars_per_exposure
    return [bind_arclength(select_stars(m, noise, minimum), calibration.camera) for m in matched]


def _sums(
    bounds: Sequence[BoundArclength],
    matched: Sequence[MatchedFrames],
    calibration: Calibration,
    counted: NDArray[np.bool_],
) -> PairSums:
    """Sum over the arcs of the frames that count: eclipse and intrusion are edited out."""
    parts = [
        pair_sums(
            b,
            m.frames.exposure_of_star // EXPOSURES_PER_FRAME,
            m.frames.n_frames,
            calibration.camera,
        )
        for b, m in zip(bounds, matched, strict=True)
    ]
    squares, pairs = (np.concatenate([getattr(p, k) for p in parts]) for k in ("squares", "pairs"))
    return PairSums(squares * counted, pairs * counted)


def _fixed(matched: Sequence[MatchedFrames]) -> Floats:
    return np.concatenate([m.frame_solved for m in matched]).astype(np.float64)


def _stars(matched: Sequence[MatchedFrames]) -> Floats:
    return np.concatenate([m.matches_per_frame for m in matched]).astype(np.float64)


def _document(
    compared: Comparison,
    batches: Sequence[FrameBatch],
    baseline: Calibration,
    candidate: Calibration,
    matcher: Matcher,
    hashes: dict[str, str],
    method: str,
) -> dict[str, Any]:
    counted = compared.counted
    figures = _figures(compared)
    selections = [bound.selection for bound in compared.bound]
    change = attitude_change(
        compared.matched[0], baseline.c_sd, compared.matched[1], candidate.c_sd
    )
    reasons, notes = _judge(compared, matcher.config.validation.minimum_frames)
    notes += _overlap(batches, candidate) + _jump(change)
    return {
        **describe.header(SCHEMA, candidate.sensor_id),
        "verdict": {"accepted": not reasons, "reasons": reasons, "notes": notes},
        "matching": method,
        "frames": len(counted),
        "counted_frames": int(counted.sum()),
        "span": describe.span_of(batches),
        "confidence": CONFIDENCE,
        **figures,
        "attitude_offset_arcsec": _rotation(change, "mean"),
        "attitude_spread_arcsec": _rotation(change, "spread"),
        "attitude_sd_of_mean_arcsec": _rotation(change, "sd_of_mean"),
        **residual_views(selections, baseline.camera, candidate.camera),
        "series": series(
            compared.matched[0], compared.matched[1],
            ("matched_baseline", "matched_candidate"), ("fix_baseline", "fix_candidate"), counted,
        ),
        "baseline": {"serial": baseline.serial, "sha256": hashes["baseline"]},
        "candidate": {"serial": candidate.serial, "sha256": hashes["candidate"]},
        "provenance": {k: v for k, v in hashes.items() if k not in ("baseline", "candidate")},
    }  # fmt: skip


def _figures(compared: Comparison) -> dict[str, Any]:
    """Availability, matched stars and common-pair RMS with their intervals."""
    count = compared.counted.astype(np.float64)
    old_fix, new_fix = (fixed * count for fixed in compared.fixed)
    # Per frame: fix and matched stars are counted where the frame counts for availability.
    old_stars, new_stars = (stars * count for stars in compared.stars)
    old, new = compared.sums
    availability = [_interval(ratio, fix, count) for fix in (old_fix, new_fix)]
    matched_ratio = _interval(ratio, new_stars, old_stars)
    rms = [_interval(root_ratio, s.squares / URAD**2, s.pairs) for s in (old, new)]
    rms_ratio = _interval(root_ratio, new.squares, old.squares)
    return {
        "availability": _pair([i.value for i in availability])
        | {"interval": _pair_of(availability)},
        "matched_stars": {"baseline": int(old_stars.sum()), "candidate": int(new_stars.sum())},
        "matched_star_ratio": number(matched_ratio.value),
        "matched_star_ratio_interval": _bounds(matched_ratio),
        "common_pair_rms_urad": _pair([i.value for i in rms]) | {"interval": _pair_of(rms)},
        "rms_ratio": number(rms_ratio.value),
        "rms_ratio_interval": _bounds(rms_ratio),
        "pairs": int(new.pairs.sum()),
        "pairs_from": compared.pairs_from,
    }


def _interval(statistic: Any, *columns: NDArray[Any]) -> Interval:
    return bootstrap(statistic, np.stack(columns, axis=1).astype(np.float64), CONFIDENCE)


def _bounds(interval: Interval) -> list[float | None]:
    return [number(interval.low), number(interval.high)]


def _pair(values: Sequence[float]) -> dict[str, Any]:
    return {
        "baseline": number(values[0]),
        "candidate": number(values[1]),
    }


def _pair_of(intervals: Sequence[Interval]) -> dict[str, Any]:
    return {"baseline": _bounds(intervals[0]), "candidate": _bounds(intervals[1])}


def _judge(compared: Comparison, minimum_frames: int) -> tuple[list[str], list[str]]:
    """Return reasons to refuse (worse beyond its margin, with confidence) and lesser notes."""
    count = compared.counted.astype(np.float64)
    old_fix, new_fix = (fixed * count for fixed in compared.fixed)
    old_stars, new_stars = (stars * count for stars in compared.stars)
    old, new = compared.sums
    if count.sum() < minimum_frames:
        return [
            f"{int(count.sum())} frames count (outside eclipse and intrusion), at least "
            f"{minimum_frames} needed"
        ], []
    if not new.pairs.sum():
        return ["neither calibration identifies any frame"], []
    # Each difference is made so that above zero is better.
    better = {
        "availability": _interval(difference, new_fix, old_fix, count),
        "matched stars": _interval(difference, new_stars, old_stars, np.maximum(old_stars, 1e-9)),
        "common-pair RMS": _interval(root_loss, new.squares, np.maximum(old.squares, 1e-30)),
    }
    reasons, notes = [], []
    for name, gain in better.items():
        text = (
            f"{name} worse by {-gain.value:.2%} (95 % interval {-gain.high:.2%} to {-gain.low:.2%})"
        )
        if gain.high < -MARGINS[name]:
            reasons.append(text)
        elif gain.value < 0:
            notes.append(text + ", within its uncertainty or without harm")
    return reasons, notes


def _overlap(batches: Sequence[FrameBatch], candidate: Calibration) -> list[str]:
    """Say when the telemetry may be what the candidate was fitted to."""
    span, fitted = describe.span_of(batches), candidate.provenance
    if not {"from", "to"} <= fitted.keys():
        return []
    if str(span["from"]) > str(fitted["to"]) or str(span["to"]) < str(fitted["from"]):
        return []
    return [
        f"the candidate was fitted to telemetry from {fitted['from']} to {fitted['to']}, which "
        "overlaps with this: the figures may not be of held-out data"
    ]


def _jump(change: MeanRotation | None) -> list[str]:
    """Say when attitudes change by more than the mean of C_SD can be off by chance."""
    if change is None:
        return []
    offset = vector_from_matrix(change.c[None])[0]
    # The update has an uncertainty of its own, of about the same size.
    if (np.abs(offset) <= _JUMP_SD * np.sqrt(2.0) * change.sd_of_mean).all():
        return []
    figures = ", ".join(f"{v:+.1f}" for v in offset / ARCSEC)
    return [
        f"attitudes change by {figures} arcsec (x, y, z of S), more than chance: the baseline's "
        "distortion turns its attitudes differently on another sky than the fit's"
    ]


def _rotation(change: MeanRotation | None, what: str) -> list[float | None] | None:
    if change is None:
        return None
    if what == "mean":
        return numbers(vector_from_matrix(change.c[None])[0] / ARCSEC)
    return numbers(getattr(change, what) / ARCSEC)
