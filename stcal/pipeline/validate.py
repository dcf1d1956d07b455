"""Stage ``validate``: two calibrations on held-out telemetry, Enright 2018 II-B and III."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.attitude import MeanRotation, mean_rotation
from stcal.calibration import Calibration
from stcal.constants import ARCSEC, URAD
from stcal.execution import OrderedMap, serial
from stcal.frames import Fragment
from stcal.geometry.rotations import vector_from_matrix
from stcal.matching import Matcher
from stcal.metrics import (
    MARGINS,
    Interval,
    PairSums,
    bootstrap,
    difference,
    ratio,
    root_loss,
    root_ratio,
)
from stcal.pipeline import describe
from stcal.pipeline.comparing import COUNTED, FIXED, PAIRS, SQUARES, STARS, compared_frames
from stcal.pipeline.fit import check_calibration
from stcal.pipeline.identifying import Series
from stcal.pipeline.numbers import number, numbers
from stcal.pipeline.pieces import Piece, pieces_of
from stcal.pipeline.views import ViewSums, residual_views, series

Floats = NDArray[np.float64]

SCHEMA = "stcal.validation/1"
CONFIDENCE = 0.95
_JUMP_SD = 3.0


@dataclass(frozen=True)
class Comparison:
    """Sums of both calibrations (baseline first) on the same frames, by block of frames.

    Attributes
    ----------
    counted : (B,) frames that count: eclipse and intrusion are edited out, here and in the others
    fixed, stars : (B,) frames with a fix, and matched stars, under each calibration
    pairs_from : the calibration whose star pairs are the common ones
    sums : arclength errors over the common pairs under each calibration
    """

    counted: Floats
    fixed: tuple[Floats, Floats]
    stars: tuple[Floats, Floats]
    pairs_from: str
    sums: tuple[PairSums, PairSums]
    views: ViewSums
    series: tuple[Series, Series]
    turns: Floats


def validate(
    fragments: Sequence[Fragment],
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
    pieces = pieces_of(fragments)
    for calibration in (baseline, candidate):
        check_calibration(calibration, matcher.config, pieces[0].fragment.sensor_id)
    compared = compare(fragments, baseline, candidate, matcher, method, mapper)
    return _document(compared, pieces, baseline, candidate, matcher, hashes, method)


def compare(
    fragments: Sequence[Fragment],
    baseline: Calibration,
    candidate: Calibration,
    matcher: Matcher,
    method: str = "lost-in-space",
    mapper: OrderedMap = serial,
) -> Comparison:
    """Rematch the frames with both calibrations and sum what the metrics need."""
    calibrations = (baseline, candidate)
    found = compared_frames(pieces_of(fragments), calibrations, matcher, method, mapper)
    sums = found.sums
    # Section II-B: common pairs are the largest set of star pairs available.
    chosen = 0 if sums[:, PAIRS[0]].sum() > sums[:, PAIRS[1]].sum() else 1
    pairs = sums[:, PAIRS[chosen]].astype(np.int64)
    old, new = (PairSums(sums[:, column], pairs) for column in SQUARES[chosen])
    return Comparison(
        counted=sums[:, COUNTED],
        fixed=(sums[:, FIXED[0]], sums[:, FIXED[1]]),
        stars=(sums[:, STARS[0]], sums[:, STARS[1]]),
        pairs_from=("baseline", "candidate")[chosen],
        sums=(old, new),
        views=found.views[chosen],
        series=found.series,
        turns=found.turns,
    )


def _document(
    compared: Comparison,
    pieces: Sequence[Piece],
    baseline: Calibration,
    candidate: Calibration,
    matcher: Matcher,
    hashes: dict[str, str],
    method: str,
) -> dict[str, Any]:
    figures = _figures(compared)
    change = mean_rotation(compared.turns)
    span = describe.span_of(piece.fragment for piece in pieces)
    reasons, notes = _judge(compared, matcher.config.validation.minimum_frames)
    notes += _overlap(span, candidate) + _jump(change)
    return {
        **describe.header(SCHEMA, candidate.sensor_id),
        "verdict": {"accepted": not reasons, "reasons": reasons, "notes": notes},
        "matching": method,
        "frames": sum(piece.n_frames for piece in pieces),
        "counted_frames": int(compared.counted.sum()),
        "span": span,
        "confidence": CONFIDENCE,
        **figures,
        "attitude_offset_arcsec": _rotation(change, "mean"),
        "attitude_spread_arcsec": _rotation(change, "spread"),
        "attitude_sd_of_mean_arcsec": _rotation(change, "sd_of_mean"),
        **residual_views(compared.views, candidate.camera),
        "series": series(
            *compared.series,
            ("matched_baseline", "matched_candidate"), ("fix_baseline", "fix_candidate"),
        ),
        "baseline": {"serial": baseline.serial, "sha256": hashes["baseline"]},
        "candidate": {"serial": candidate.serial, "sha256": hashes["candidate"]},
        "provenance": {k: v for k, v in hashes.items() if k not in ("baseline", "candidate")},
    }  # fmt: skip


def _figures(compared: Comparison) -> dict[str, Any]:
    """Availability, matched stars and common-pair RMS with their intervals."""
    count, fixed, (old_stars, new_stars) = compared.counted, compared.fixed, compared.stars
    old, new = compared.sums
    availability = [_interval(ratio, fix, count) for fix in fixed]
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
    count, (old_fix, new_fix) = compared.counted, compared.fixed
    (old_stars, new_stars), (old, new) = compared.stars, compared.sums
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


def _overlap(span: dict[str, Any], candidate: Calibration) -> list[str]:
    """Say when the telemetry may be what the candidate was fitted to."""
    fitted = candidate.provenance
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
