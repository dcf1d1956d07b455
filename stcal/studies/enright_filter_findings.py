"""Which findings of Enright 2018 hold in a run of the study: those on the filters' histories."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stcal.studies.findings import (
    FAILS,
    HOLDS,
    OPEN,
    PARTLY,
    Claim,
    Document,
    listed,
    named,
    number_at,
    out_of,
    verdict_of,
)

Floats = NDArray[np.float64]

# Two starts end in the same parameters when no parameter differs by more than this part of its sd;
# they differ when one does by more than its sd.
_SAME_SD, _OTHER_SD = 0.5, 1.0
# "Very close": how far the tail may end from the aggregate, in percent.
_CLOSE_PERCENT = 1.0
# Within this distance of the boresight the radial curves agree, to the noise of one centroid.
_INNER_PX = 800.0
# Gains: the share of the final availability's gain that counts as most of it, the smallest gain
# worth the name, and how near to its final value the RMS has settled.
_MOST_OF_GAIN, _LEAST_GAIN, _SETTLED = 0.9, 0.02, 0.02
_FEW_FRAMES = 5

_START = Claim(
    "Rematching filters forget where they started",
    "III-B.2, Figures 3a and 3b",
    "Started from the laboratory or from the batch calibration, the Q and No-Q filters end in "
    "consistent parameters; the No-Refit filter does not, since it sees other stars.",
    {
        HOLDS: "After a few frames the matches no longer depend on the start, so both runs see the "
        "same data; matches made with the starting camera stay different to the end.",
        PARTLY: "Either the matches of both starts are nearly the same for every filter, or a "
        "filter still remembers its start.",
        FAILS: "The frames of this run are too few for the filters to forget their start.",
    },
)
_WANDER = Claim(
    "With process noise the estimates wander and overfit each frame",
    "III-B.2, Figure 4",
    "The Q estimates wander after convergence. The No-Q error over the whole set (tail) ends very "
    "close to its per-frame value (aggregate); the Q filter's aggregate lies well below its tail.",
    {
        HOLDS: "Process noise keeps the gain up, so each frame's noise moves the estimate. Here "
        "nothing but white noise can: wandering as such is no sign of a physical change.",
        PARTLY: "The process noise is too small, or the frames are too few, to tell the filters "
        "apart for every sensor.",
        FAILS: "The process noise of this run is too small to move the estimates.",
    },
)
_RADIAL = Claim(
    "Distortion coefficients differ, the radial curve does not",
    "III-B.2, Table VII, Figure 5",
    "Filters can end at notably different distortion coefficients than the batch fit, yet within "
    "about 800 pixels of the boresight the radial curve is quite similar.",
    {
        HOLDS: "f, b4 and b2 are strongly correlated: they trade against each other where stars "
        "are, and show only towards the corners.",
        PARTLY: "All filters end at the coefficients of the batch fit, so there is no difference "
        "to cancel.",
        FAILS: "A filter's distortion differs by more than a star's noise even near the boresight.",
    },
)
_AVAILABILITY = Claim(
    "Availability comes first, accuracy later",
    "IV",
    "Most of the gain in availability is made in the first few frames; the error takes "
    "significantly longer to settle.",
    {
        HOLDS: "Matching tolerates an error of some hundred µrad, so that a rough focal length is "
        "enough; the error goes on falling as noise averages out.",
        PARTLY: "For some sensors both settle at once.",
        FAILS: "The error settles as early as the availability.",
    },
)


def start_is_forgotten(sensors: Sequence[Document]) -> dict[str, str]:
    """Finding 6, Figures 3a and 3b."""
    apart = {
        name: np.array([start_difference(sensor, name) for sensor in sensors])
        for name in ("q", "no_q", "no_refit")
    }
    same = np.maximum(apart["q"], apart["no_q"]) <= _SAME_SD
    other = apart["no_refit"] > _OTHER_SD
    here = (
        f"{named(sensors)}: both starts end apart by at most, of a parameter, "
        f"{listed(apart['q'], 2, 'sd', False)} (Q), {listed(apart['no_q'], 2, 'sd', False)} "
        f"(No-Q) and {listed(apart['no_refit'], 1, 'sd', False)} (No-Refit), the last by more than "
        f"{_OTHER_SD:g} sd for {out_of(other)} sensors."
    )
    differs = bool(2 * other.sum() > len(other))
    return _START.judged(verdict_of(same & differs, bool(same.all() or differs)), here)


def start_difference(sensor: Document, name: str) -> float:
    """Largest difference of a parameter between both starts of a filter, in its sd."""
    lab, batch, sd = (_row(sensor, "ends", name, key) for key in ("lab", "batch", "sd"))
    return float(np.max(np.abs(lab - batch) / sd))


def q_wanders(sensors: Sequence[Document]) -> dict[str, str]:
    """Finding 7, Figure 4."""
    ratio = np.array([wander_ratio(sensor) for sensor in sensors])
    q, no_q = (np.array([tail_excess(s, name) for s in sensors]) for name in ("q", "no_q"))
    wanders, close, overfits = ratio > 1.0, np.abs(no_q) <= _CLOSE_PERCENT, q > 2.0 * np.abs(no_q)
    here = (
        f"{named(sensors)}: over the second half of the frames the Q estimates spread "
        f"{listed(ratio, 1, signed=False)} times as far as the No-Q ones. The tail ends above the "
        f"aggregate by {listed(no_q, 1, '%')} (No-Q) and {listed(q, 1, '%')} (Q)."
    )
    return _WANDER.judged(verdict_of(wanders & close & overfits), here)


def wander_ratio(sensor: Document) -> float:
    """Spread of the Q estimates over that of the No-Q estimates, median over the parameters."""
    q, no_q = (_row(sensor, "ends", name, "wander") for name in ("q", "no_q"))
    return float(np.median(q / no_q))


def tail_excess(sensor: Document, name: str) -> float:
    """By how much the tail's last RMS exceeds the aggregate, in percent."""
    tail = _row(sensor, "errors", name, "tail_urad")
    aggregate = number_at(sensor, "errors", name, "aggregate_urad")
    return float(100.0 * (tail[-1] / aggregate - 1.0)) if len(tail) else float("nan")


def radial_curve_agrees(sensors: Sequence[Document]) -> dict[str, str]:
    """Finding 8, Table VII and Figure 5."""
    inner = np.array([inner_difference_px(sensor) for sensor in sensors])
    noise = np.array([number_at(sensor, "settings", "noise_sd_px") for sensor in sensors])
    moved = {name: [coefficient_difference(s, name) for s in sensors]
             for name in ("q", "no_q", "no_refit")}  # fmt: skip
    largest = {name: float(np.max(values, initial=0.0)) for name, values in moved.items()}
    agrees, differs = inner <= noise, max(largest.values()) > _OTHER_SD
    here = (
        "b4 or b2 differ from the batch fit by up to "
        f"{largest['q']:.1f} sd (Q), {largest['no_q']:.1f} sd (No-Q) and "
        f"{largest['no_refit']:.1f} sd (No-Refit). {named(sensors)}: out to {_INNER_PX:g} px the "
        f"radial curves stay within {listed(inner, 2, 'px', False)} of the batch fit's; the sd of "
        f"a centroid is taken as {float(noise.max(initial=0.0)):g} px."
    )
    return _RADIAL.judged(verdict_of(agrees & differs, bool(agrees.all())), here)


def inner_difference_px(sensor: Document) -> float:
    """Largest radial difference of a filter's camera near the boresight, in px."""
    near = _row(sensor, "radial", "radius_px") <= _INNER_PX
    curves = [_row(sensor, "radial", name) for name in ("q", "no_q", "no_refit")]
    return float(np.max([np.abs(curve[near]).max() for curve in curves]))


def coefficient_difference(sensor: Document, name: str) -> float:
    """Larger difference of b4 and b2 from the batch fit, in the batch fit's sd."""
    rows = [row for row in sensor["parameters"] if row["name"] in ("b4_per_m4", "b2_per_m2")]
    return max(
        abs(number_at(row, "fitted", name) - number_at(row, "fitted", "batch"))
        / number_at(row, "sd", "batch")
        for row in rows
    )


def availability_first(sensors: Sequence[Document]) -> dict[str, str]:
    """Finding 9, section IV."""
    gaining = [sensor for sensor in sensors if _gain(sensor) >= _LEAST_GAIN]
    if not gaining:
        return _AVAILABILITY.judged(OPEN, "No sensor gains availability on the validation data.")
    gained, settled = (
        np.array([frames_until(sensor, key) for sensor in gaining])
        for key in ("availability", "rms_urad")
    )
    first = (gained <= _FEW_FRAMES) & (settled > gained)
    here = (
        f"{named(gaining)}: {100 * _MOST_OF_GAIN:g} % of the gain in availability takes "
        f"{listed(gained, 0, signed=False)} frames; until the RMS stays within "
        f"{100 * _SETTLED:g} % of its final value it takes {listed(settled, 0, signed=False)}."
    )
    return _AVAILABILITY.judged(verdict_of(first), here)


def frames_until(sensor: Document, key: str) -> float:
    """Frames after which availability has gained most, or the RMS stays near its final value."""
    frame, values = _row(sensor, "settling", "frame"), _row(sensor, "settling", key)
    if key == "availability":
        reached = values >= values[0] + _MOST_OF_GAIN * (values[-1] - values[0])
        return float(frame[np.argmax(reached)])
    away = np.flatnonzero(~(np.abs(values / values[-1] - 1.0) <= _SETTLED))
    return float(frame[away[-1] + 1]) if len(away) else float(frame[0])


def _gain(sensor: Document) -> float:
    values = _row(sensor, "settling", "availability")
    return float(values[-1] - values[0])


def _row(sensor: Document, *keys: str) -> Floats:
    """Return the numbers (N,) at a path of keys, NaN where one is None."""
    found = sensor
    for key in keys:
        found = found[key]
    return np.array(found, dtype=np.float64)
