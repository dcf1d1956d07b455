"""What the study ``estimators`` finds: expectations of theory, judged by its numbers alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.report.format import fixed, percent
from stcal.studies.findings import FAILS, HOLDS, PARTLY, Claim, Document, number_at

Floats = NDArray[np.float64]

# Errors within this of one another count as equal, and within this of the efficient estimate's as
# being at the bound.
_EQUAL, _AT_BOUND = 1.02, 1.05
# Errors over sd beyond this, of those of the efficient estimate, show an sd that is too small.
_DISHONEST = 1.2
# A condition is mastered when so many runs end well.
_MASTERED = 0.95

_SAME = Claim(
    "The residual decides on accuracy, not the estimator",
    "theory of least squares",
    "With constant parameters, every estimator of one residual ends at the same minimum.",
    {
        HOLDS: "The weight of a prior that covers the start is small, and the latest frames are "
        "linearised anew until the estimate has settled.",
        PARTLY: "True of half the residuals or more.",
        FAILS: "Some estimators end elsewhere: see the runs refused or lost in the table.",
    },
)
_EFFICIENT = Claim(
    "Directions and arclengths reach the bound",
    "Enright 2018, II; attitude projected out",
    "Both hold all that centroids say of the camera, each with its full covariance.",
    {
        HOLDS: "Nothing of the information is lost.",
        PARTLY: "One of them does, on all sensors.",
        FAILS: "Starts or outliers have led some runs elsewhere.",
    },
)
_COSINE = Claim(
    "Inner products of one variance report too small an sd",
    "Zhang 2024; correlated rows",
    "Pairs that share a star are correlated; taken as independent, they count several times.",
    {
        HOLDS: "N stars make more pairs than they have freedom: the sd falls with every pair.",
        PARTLY: "True of half the sensors or more.",
        FAILS: "Too few pairs share stars here.",
    },
)
_UNSCENTED = Claim(
    "The unscented filter gains nothing over the extended one",
    "nearly linear measurements",
    "No better error, no more runs that end well, and more time.",
    {
        HOLDS: "The sd shrinks so fast that the measurement is linear within it.",
        PARTLY: "One of accuracy and robustness is no better.",
        FAILS: "Sigma points help on the way from a bad start or past false matches.",
    },
)
_SCREENING = Claim(
    "Screening copes with 3 % of false matches",
    "robust estimation",
    "Stars that depart from their exposure's attitude are left out before they count.",
    {
        HOLDS: "A false match stands out among a dozen stars of one attitude.",
        PARTLY: "It copes in half the combinations or more.",
        FAILS: "From a start as poor as the one on board, good stars depart as much as false ones.",
    },
)
_START = Claim(
    "A start 8 sigma off is good enough",
    "prior of the filters, 10 sigma",
    "The filters' prior covers it, and a batch fit needs none.",
    {
        HOLDS: "The measurements are nearly linear that far out.",
        PARTLY: "It is in half the combinations or more.",
        FAILS: "The fits run into wrong minima from there.",
    },
)


def findings(document: Document) -> list[dict[str, str]]:
    """Return the findings of a study's document."""
    rows = document["choice"]["summaries"]
    robustness = document["robustness"]
    return [
        _same(rows),
        _efficient(rows),
        _cosine(document),
        _unscented(rows),
        _mastered(_SCREENING, robustness, "false_matches", robustness["false_shares"].index(0.03)),
        _mastered(_START, robustness, "starts", robustness["start_sigma"].index(8.0)),
    ]


def _verdict(share: float) -> str:
    return HOLDS if share >= 1.0 else PARTLY if share >= 0.5 else FAILS


def _column(rows: Sequence[Document], residual: str, key: str) -> Floats:
    """Return a figure of a residual's combinations, estimator by estimator."""
    return np.array([number_at(row, key) for row in rows if row["residual"] == residual])


def _residuals(rows: Sequence[Document]) -> list[str]:
    return list(dict.fromkeys(row["residual"] for row in rows))


def _same(rows: Sequence[Document]) -> dict[str, str]:
    found = {name: _column(rows, name, "over_efficient") for name in _residuals(rows)}
    spread = {name: float(v.max() / v.min()) for name, v in found.items()}
    share = float(np.mean([value <= _EQUAL for value in spread.values()]))
    here = "Largest over smallest error among the estimators: " + _by_name(spread, 3)
    return _SAME.judged(_verdict(share), here)


def _efficient(rows: Sequence[Document]) -> dict[str, str]:
    best = {name: float(_column(rows, name, "over_efficient").min()) for name in _residuals(rows)}
    claimed = [best[name] <= _AT_BOUND for name in ("direction", "arclength")]
    here = "Error over the efficient estimate's, worst sensor, best estimator: " + _by_name(best, 3)
    return _EFFICIENT.judged(_verdict(float(np.mean(claimed))), here)


def _cosine(document: Document) -> dict[str, str]:
    least = {
        name: float(np.nanmin(_column(sensor["combinations"], "cosine", "honesty")))
        for name, sensor in document["sensors"].items()
    }
    share = float(np.mean([value > _DISHONEST for value in least.values()]))
    here = "Errors over sd, against the efficient estimate's: " + _by_name(least, 2)
    return _COSINE.judged(_verdict(share), here)


def _unscented(rows: Sequence[Document]) -> dict[str, str]:
    by = {name: [r for r in rows if r["estimator"] == name] for name in ("ekf", "ukf")}
    error, robust, seconds = (
        {n: np.array([number_at(r, key) for r in found]) for n, found in by.items()}
        for key in ("over_efficient", "robust", "us_per_frame")
    )
    gain = float(np.max(error["ekf"] / error["ukf"]))
    more = float(np.max(robust["ukf"] - robust["ekf"]))
    cost = float(np.mean(seconds["ukf"] / seconds["ekf"]))
    share = float(np.mean([gain <= _EQUAL, more <= 1.0 - _MASTERED]))
    here = (
        f"Error of the extended filter over the unscented one's: at most {fixed(gain, 3)}; runs "
        f"that end well: at most {percent(more)} more; time: {fixed(cost)} times."
    )
    return _UNSCENTED.judged(_verdict(share), here)


def _mastered(claim: Claim, robustness: Document, kind: str, place: int) -> dict[str, str]:
    shares = {
        f"{item['residual']}/{item['estimator']}": item[kind]["well"][place]
        for item in robustness["combinations"]
    }
    share = float(np.mean([value >= _MASTERED for value in shares.values()]))
    worst = min(shares, key=lambda name: shares[name])
    here = (
        f"{sum(value >= _MASTERED for value in shares.values())} of {len(shares)} combinations "
        f"end well in {percent(_MASTERED)} of the runs or more; the worst, {worst}, in "
        f"{percent(shares[worst])}."
    )
    return claim.judged(_verdict(share), here)


def _by_name(values: dict[str, Any], decimals: int) -> str:
    shown = ", ".join(f"{name} {fixed(value, decimals)}" for name, value in values.items())
    return f"{shown}."
