"""Which findings of Zhang et al. 2024 hold: those on noise, on the filter, and on the mounting."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stcal.report.format import fixed, significant
from stcal.studies.findings import (
    FAILS,
    HOLDS,
    PARTLY,
    Claim,
    Document,
    number_at,
    out_of,
    verdict_of,
)
from stcal.studies.zhang_alignment import TRUE
from stcal.studies.zhang_calibration import settled_s
from stcal.studies.zhang_paper import NAMES
from stcal.studies.zhang_runs import FILTERS, OURS, PAPER

Floats = NDArray[np.float64]

# An RMS over the bound that is above this is no longer efficient; so much it scatters with a
# hundred runs, all parameters taken together.
_EFFICIENT = 1.15
# An error above this many of its own sd is not what the filter says it is.
_CONSISTENT = 1.3
# Published errors of one run count as found again within this factor.
_LIKE = 3.0
# The mounting has converged when its error stays within this of the last one.
_SETTLED = 1.1

_NOISE = Claim(
    "More noise, more error",
    "Evaluation of the effect of noise, Figure 11",
    "An increase in noise causes an increase in the absolute error.",
    {
        HOLDS: "The measurement is nearly linear in the noise and in what is left of the initial "
        "error, so that errors are proportional to the noise.",
        PARTLY: "The errors of some levels are hidden by the scatter of so few runs.",
        FAILS: "The runs are too few to tell the levels apart.",
    },
)
_LOW_FREQUENCY = Claim(
    "Noise of low frequency is part of the model",
    "Error sources of star sensor, eqs (9)-(10)",
    "Random errors are the noise equivalent angle and the low frequency error; both are in the "
    "model, and their impact is considered.",
    {
        HOLDS: "The low-frequency noise of this run is too small to matter.",
        PARTLY: "A displacement of the whole image is a turn of the sensor but for a term of the "
        "second order: the attitude absorbs it. A distortion of the field, however small, is what "
        "a shift of the principal point looks like once the attitude is taken out; it does not "
        "average out as white noise does, and a filter that takes all noise for white does not "
        "know.",
        FAILS: "The filters take all noise for white.",
    },
)
_FILTER = Claim(
    "An unscented filter on the inner products of star pairs",
    "The first stage of the algorithm, eqs (22)-(39)",
    "The camera is estimated by an unscented filter whose measurements are the inner products of "
    "star pairs.",
    {
        HOLDS: "The pairs of this run lose nothing by being taken as independent.",
        PARTLY: "The filter works, but pairs share stars, and a wide pair's product is noisier "
        "than a narrow one's: taken as independent and alike they waste information, and the "
        "filter's own sd is too small. With their covariance the bound is reached. The unscented "
        "update itself gains nothing: the measurement is nearly linear over the filter's sd.",
        FAILS: "Taken as independent and alike, the products waste most of what they tell.",
    },
)
_MOUNTING = Claim(
    "The mounting is found to 0.0076 deg",
    "Evaluation of LKF algorithm, eq (53), Table 5",
    "The mean absolute error is 4.4e-5 of the elements, 3.3e-6 of those on the diagonal, and "
    "0.0076 deg of the angles.",
    {
        HOLDS: "It is wholly the error of the fitted camera: a principal point that is a pixel off "
        "is a turn of 0.014 deg, in every image the same. The published angle fits a principal "
        "point that is half a pixel off, and thus one run at the bound, not the published errors "
        "of the first stage.",
        PARTLY: "Some of the errors are not those published.",
        FAILS: "The error of the fitted camera goes into the mounting, and differs here.",
    },
)
_MOUNTING_TIME = Claim(
    "The mounting converges within 200 s",
    "Evaluation of LKF algorithm, Figure 12",
    "All elements of the matrix converge after 200 s.",
    {
        HOLDS: "The noise of stars and attitudes averages out in a few images, down to the error "
        "of the fitted camera, which no number of images reduces.",
        FAILS: "The noise of the attitude still moves the estimate.",
    },
)


def noise_raises_errors(document: Document) -> dict[str, str]:
    """Finding 5, Figure 11."""
    levels = document["noise_levels"]
    noise = np.array([number_at(level, "noise_px") for level in levels])
    rms = np.array([by_name(level, "filters", PAPER, "rms") for level in levels])
    rises = np.asarray((np.diff(rms, axis=0) > 0.0).all(axis=0))
    slope = np.log(rms[-1] / rms[0]) / np.log(noise[-1] / noise[0])
    here = (
        f"From {noise[0]:g} to {noise[-1]:g} px the RMS errors after "
        f"{number_at(levels[0], 't_s'):.0f} s rise with the noise to the power of "
        f"{', '.join(fixed(float(value)) for value in slope)} (x0, y0, f, k1, k2), at every step "
        f"for {out_of(rises)} parameters."
    )
    return _NOISE.judged(verdict_of(rises), here)


def low_frequency_matters(document: Document) -> dict[str, str]:
    """Finding 6: the errors with LFE against those without, and against the filter's own sd."""
    cases = {case["case"]: case for case in document["low_frequency"]}
    white = document["errors"]
    told = {}
    for name, case in (("white", white), *cases.items()):
        scatter = _together(by_name(case, "filters", OURS, "consistency"))
        rms = by_name(case, "filters", OURS, "rms")[:2]
        told[name] = (scatter, float(np.sqrt((rms**2).mean())))
    noise = {name: number_at(case, "noise", name) for name, case in cases.items()}
    here = (
        "The square-root filter on arclengths has a principal point error of "
        f"{fixed(told['white'][1], 2, 'px')} RMS and errors of {fixed(told['white'][0])} times its "
        f"own sd with white noise alone. With a displacement of {noise['common']:g} px in "
        f"addition: {fixed(told['common'][1], 2, 'px')} and {fixed(told['common'][0])}; with a "
        f"distortion of the field of {noise['field']:g} px: {fixed(told['field'][1], 2, 'px')} and "
        f"{fixed(told['field'][0])}; with both: {fixed(told['both'][1], 2, 'px')} and "
        f"{fixed(told['both'][0])}."
    )
    hits = np.array([told[name][0] <= _CONSISTENT for name in ("common", "field", "both")])
    return _LOW_FREQUENCY.judged(verdict_of(hits, bool(hits[0])), here)


def filter_is_right(document: Document) -> dict[str, str]:
    """Finding 7: RMS over the bound, and over the filter's own sd."""
    over_bound, consistency = (
        {n: _together(by_name(document, "errors", "filters", n, key)) for n in FILTERS}
        for key in ("over_bound", "consistency")
    )
    both = [by_name(document, "errors", "filters", n, "rms") for n in ("ukf_arclength", OURS)]
    apart = 100.0 * float(np.abs(both[0] / both[1] - 1.0).max())
    here = (
        f"Errors on inner products are {fixed(over_bound[PAPER])} times the bound and "
        f"{fixed(consistency[PAPER])} times the filter's own sd, all parameters together; on "
        f"arclengths with their covariance {fixed(over_bound[OURS])} and "
        f"{fixed(consistency[OURS])}, on directions {fixed(over_bound['sqrf_direction'])} and "
        f"{fixed(consistency['sqrf_direction'])}. On the same arclengths the errors of the "
        "unscented and the square-root filter differ by "
        f"{fixed(apart, 2, '%')} at most."
    )
    good = over_bound[PAPER] <= _EFFICIENT and consistency[PAPER] <= _CONSISTENT
    return _FILTER.judged(verdict_of(np.array([good]), over_bound[PAPER] <= 2.0), here)


def mounting_is_accurate(document: Document) -> dict[str, str]:
    """Finding 8, eq (53) and Table 5."""
    keys = ("element", "diagonal", "angle_deg")
    read = document["alignment"]["cameras"]
    found = {
        camera: np.array([number_at(read, camera, "linear", "read", key) for key in keys])
        for camera in (PAPER, OURS, TRUE)
    }
    published = np.array([number_at(document, "paper", "alignment", key) for key in keys])
    like = (found[PAPER] <= _LIKE * published) & (found[PAPER] >= published / _LIKE)
    own, whole = (number_at(read, PAPER, "linear", "read", k) for k in ("own_sd_deg", "sd_deg"))
    here = (
        f"After {number_at(document, 'alignment', 'read_s'):.0f} s, with the paper's camera: "
        f"{_three(found[PAPER])}; with that of the square-root filter: {_three(found[OURS])}; with "
        f"the true camera: {_three(found[TRUE])}. The second stage's own sd is "
        f"{fixed(own, 5, 'deg')}; with the uncertainty of the camera {fixed(whole, 4, 'deg')}. "
        f"{_printed(document)}"
    )
    return _MOUNTING.judged(verdict_of(like), here)


def _three(errors: Floats) -> str:
    return (
        f"{significant(float(errors[0]), 2)} (elements), {significant(float(errors[1]), 2)} "
        f"(diagonal), {fixed(float(errors[2]), 4, 'deg')}"
    )


def _printed(document: Document) -> str:
    """Say what the printed matrices themselves differ by."""
    printed = document["paper"]["printed"]
    turns = ", ".join(fixed(angle, 4, signed=True) for angle in printed["angles_deg"])
    return (
        f"The printed matrices (52) and (53) differ by {significant(printed['element'], 2)} on "
        f"average and, made rotations, by {turns} deg about x, y, z: the published 0.0076 deg is "
        "the largest of the angles, not their mean."
    )


def mounting_converges(document: Document) -> dict[str, str]:
    """Finding 9, Figure 12."""
    section = document["alignment"]
    limit = number_at(document, "paper", "alignment_s")
    t_s = np.array(section["t_s"], dtype=np.float64)
    errors = {
        camera: np.array(section["cameras"][camera]["linear"]["angle_deg"], dtype=np.float64)
        for camera in (PAPER, TRUE)
    }
    times = {name: settled_s(t_s, e, _SETTLED * float(e[-1])) for name, e in errors.items()}
    first, last = (fixed(float(errors[PAPER][k]), 4, "deg") for k in (0, -1))
    here = (
        "With the paper's camera the mean absolute angle error falls from "
        f"{first} after {t_s[0]:.0f} s to {last} after {t_s[-1]:.0f} s, and is within a tenth of "
        f"that from {times[PAPER]:.0f} s on. With the true camera, where only noise is left, it "
        f"falls on and gets there at {times[TRUE]:.0f} s."
    )
    return _MOUNTING_TIME.judged(verdict_of(np.array([times[PAPER] <= limit])), here)


def _together(values: Floats) -> float:
    """Return the root mean square over the parameters."""
    return float(np.sqrt((values**2).mean()))


def by_name(document: Document, *keys: str) -> Floats:
    """Return the numbers (P,) of the parameters at a path of keys, NaN where there is none."""
    return np.array([number_at(document, *keys, name) for name in NAMES])
