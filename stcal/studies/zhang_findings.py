"""Which findings of Zhang et al. 2024 hold in a run of the study: those on its first stage.

Each is decided from the numbers alone.  A published error is set against the Cramer-Rao bound of
one run and, since the paper averages its runs, against that bound over the root of their number.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from stcal.report.format import fixed, significant
from stcal.studies import zhang_method_findings as methods
from stcal.studies.findings import FAILS, HOLDS, PARTLY, Claim, Document, number_at, verdict_of
from stcal.studies.zhang_method_findings import by_name
from stcal.studies.zhang_paper import NAMES
from stcal.studies.zhang_runs import OURS, PAPER
from stcal.units import unit_of

Floats = NDArray[np.float64]

# How near to a corner of the detector a maximum counts as in it.
_CORNER_PX = 1.0

_CONVERGENCE = Claim(
    "All five parameters converge within 300 s",
    "Evaluation of UKF algorithm, Figures 7 and 8",
    "With 0.2 px noise, and averaged over 100 runs, all parameters converge after 300 s.",
    {
        HOLDS: "Some thousand star pairs fix what the initial values had wrong.",
        PARTLY: "Averaging the curves of many runs takes the noise out: what is left is how fast "
        "the filter forgets its start. In a single run noise is still a good part of the initial "
        "error, and falls with the root of time: there is no time after which it has converged.",
        FAILS: "The images of this run are too few to forget the start.",
    },
)
_ERRORS = Claim(
    "The errors after 300 s are far below a pixel and a micrometre",
    "Evaluation of UKF algorithm, Table 3",
    "The principal point is off by 0.01 and 0.03 px, the focal length by 0.001 mm, k1 by "
    "0.03e-8 px⁻² and k2 by 0.004e-14 px⁻⁴.",
    {
        HOLDS: "The bound of this scenario allows such errors in every run.",
        PARTLY: "A single run cannot reach some of the published errors but by chance; the average "
        "of 100 runs can, and it is this that the paper takes the error of.",
        FAILS: "No estimator reaches an error below the bound but by chance. In a narrow field a "
        "shift of the principal point looks like a turn of the sensor, so that images tell little "
        "about it. The published errors are those of an average over 100 runs, and some are small "
        "even for that; no sensor in orbit has 100 runs.",
    },
)
_MEAN_SQUARE = Claim(
    "The mean square error is 0.1 px after 100 s and 0.0013 px after 500 s",
    "Evaluation of UKF algorithm, Figure 9",
    "The mean square error of the optical parameters falls to 0.1 px after 100 s and 0.0013 px "
    "after 500 s.",
    {
        HOLDS: "The bound of this scenario allows such errors in every run.",
        PARTLY: "The published values fit the square of an averaged curve, not the mean of the "
        "squares of single ones.",
        FAILS: "The published values are below what even an average of 100 runs leaves.",
    },
)
_DISTORTION = Claim(
    "The residual distortion is largest at the corners, 0.13 px",
    "Evaluation of UKF algorithm, Figure 10",
    "The residual by lens distortion has its maximum of 0.13 px at the corner points.",
    {
        HOLDS: "Errors of k1 and k2 go with the third and the fifth power of the distance from the "
        "principal point; in a fit they compensate each other where stars are.",
        PARTLY: "The distortion left is largest elsewhere, or larger than published.",
        FAILS: "The distortion left is larger than published, and not at the corners.",
    },
)


def findings(document: Document) -> list[dict[str, str]]:
    """Return the nine findings, judged by the numbers of the study's document."""
    tests: tuple[Callable[[Document], dict[str, str]], ...] = (
        converges,
        errors_are_small,
        mean_square_falls,
        distortion_at_corners,
        methods.noise_raises_errors,
        methods.low_frequency_matters,
        methods.filter_is_right,
        methods.mounting_is_accurate,
        methods.mounting_converges,
    )
    return [test(document) for test in tests]


def converges(document: Document) -> dict[str, str]:
    """Finding 1, Figures 7 and 8."""
    limit = number_at(document, "paper", "calibration_s")
    times = {
        kind: by_name(document, "convergence", "filters", PAPER, "converged", kind)
        for kind in ("averaged", "absolute")
    }
    within = {kind: found <= limit for kind, found in times.items()}
    here = (
        "With the paper's filter, the averaged curve stays within a tenth of the initial error "
        f"from {_seconds(times['averaged'])} on, the mean absolute error of single runs from "
        f"{_seconds(times['absolute'])} on."
    )
    verdict = verdict_of(within["averaged"] & within["absolute"], bool(within["averaged"].all()))
    return _CONVERGENCE.judged(verdict, here)


def _seconds(times: Floats) -> str:
    """Return ``x0 39 s, ..., k2 never``."""
    shown = ("never" if np.isnan(time) else f"{time:.0f} s" for time in times)
    return ", ".join(f"{unit_of(n).symbol} {time}" for n, time in zip(NAMES, shown, strict=True))


def errors_are_small(document: Document) -> dict[str, str]:
    """Finding 2, Table 3."""
    published = by_name(document, "paper", "error")
    bound = by_name(document, "errors", "bound")
    least = bound / np.sqrt(number_at(document, "paper", "runs"))
    rms = {name: by_name(document, "errors", "filters", name, "rms") for name in (PAPER, OURS)}
    reached = bound <= published
    here = (
        f"The bound of one run is {_in_units(bound)}; the paper's filter has an RMS error of "
        f"{_in_units(rms[PAPER])}, the square-root filter on arclengths {_in_units(rms[OURS])}. "
    )
    if (published < bound).any():
        here += _below_the_bound(published, bound, least)
    return _ERRORS.judged(verdict_of(reached, bool((least <= published).all())), here)


def _below_the_bound(published: Floats, bound: Floats, least: Floats) -> str:
    """Say which published errors are below the bound, and how likely that is."""
    places = [k for k in range(len(NAMES)) if published[k] < bound[k]]
    parts = [
        f"{unit_of(NAMES[k]).symbol} {bound[k] / published[k]:.0f} times "
        f"({_chance(published[k] / bound[k])}, {_chance(published[k] / least[k])})"
        for k in places
    ]
    worst = max(bound[k] / published[k] for k in places)
    return (
        "Published errors below it, with the chance that an error is so small in one run, and in "
        f"an average of 100: {', '.join(parts)}. To have the smallest as a bound takes "
        f"{worst**2:.0f} times as many images, or {worst:.0f} times less noise."
    )


def _chance(size: float) -> str:
    """Return how likely an error is at most ``size`` sd."""
    return f"{100.0 * erf(size / np.sqrt(2.0)):.0f} %"


def mean_square_falls(document: Document) -> dict[str, str]:
    """Finding 3, Figure 9."""
    at = [float(t) for t in document["paper"]["mean_square"]["t_s"]]
    published = np.array(document["paper"]["mean_square"]["px2"], dtype=np.float64)
    section = document["mean_square"]
    bound = _at_times(section["t_s"], section["bound"]["optical"], at)
    of_filter = section["filters"][PAPER]
    single, averaged, image = (
        _at_times(section["t_s"], of_filter[key], at) for key in ("optical", "averaged", "image")
    )
    runs = number_at(document, "paper", "runs")
    here = (
        f"After {at[0]:.0f} and {at[1]:.0f} s, of x0, y0 and f in pixels: bound of one run "
        f"{_pair(bound)} px², single runs of the paper's filter {_pair(single)} px², its curve "
        f"averaged over {document['runs']} runs {_pair(averaged)} px²; an average of {runs:.0f} "
        f"runs has a bound of {_pair(bound / runs)} px². On the detector, where the errors of "
        f"principal point and attitude compensate, single runs leave {_pair(image)} px²."
    )
    allowed = bound / runs <= published
    return _MEAN_SQUARE.judged(verdict_of(bound <= published, bool(allowed.any())), here)


def _at_times(t_s: Sequence[float], values: Sequence[float | None], at: list[float]) -> Floats:
    """Return the values at the shown times nearest to others."""
    places = [int(np.argmin(np.abs(np.array(t_s) - time))) for time in at]
    return np.array([values[k] for k in places], dtype=np.float64)


def _pair(values: Floats) -> str:
    return " and ".join(significant(float(value), 2) for value in values)


def distortion_at_corners(document: Document) -> dict[str, str]:
    """Finding 4, Figure 10."""
    published = number_at(document, "paper", "largest_distortion_px")
    found = document["distortion"][PAPER]
    place = [number_at(found, "largest", "distortion", key) for key in ("row_px", "col_px")]
    in_corner = all(
        min(value + 0.5, number_at(found, side) - 0.5 - value) <= _CORNER_PX
        for value, side in zip(place, ("rows", "cols"), strict=True)
    )
    largest = {
        key: number_at(document, "distortion", name, "largest", kind, "px")
        for key, name, kind in (
            ("paper", PAPER, "distortion"),
            ("ours", OURS, "distortion"),
            ("whole", PAPER, "image"),
        )
    }
    here = (
        f"After {number_at(found, 't_s'):.0f} s the errors of k1 and k2 displace stars by up to "
        f"{fixed(largest['paper'], 3, 'px')} RMS with the paper's filter, at row "
        f"{fixed(place[0], 0)}, column {fixed(place[1], 0)}, and by "
        f"{fixed(largest['ours'], 3, 'px')} with the square-root filter on arclengths. With all "
        "parameters, and the sensor's turn taken out, it is "
        f"{fixed(largest['whole'], 3, 'px')}. The published errors of k1 and k2 make "
        f"{fixed(number_at(found, 'published'), 2, 'px')} at the farthest corner, which agrees "
        "with the figure; they are the error of one run or worse, not of an average."
    )
    hits = np.array([largest["paper"] <= published, in_corner])
    return _DISTORTION.judged(verdict_of(hits), here)


def _in_units(values: Floats) -> str:
    """Return the parameters' values with their units."""
    parts = (_in_unit(k, float(value)) for k, value in enumerate(values))
    return ", ".join(f"{unit_of(n).symbol} {part}" for n, part in zip(NAMES, parts, strict=True))


def _in_unit(place: int, value: float) -> str:
    unit = unit_of(NAMES[place])
    shown = significant(value / unit.size, 2)
    return f"{shown} × {unit.shown}" if unit.shown.startswith("10") else f"{shown} {unit.shown}"
