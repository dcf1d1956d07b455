"""Which combination to use: chosen by rule from the figures of the study ``estimators``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from stcal.pipeline.numbers import number
from stcal.studies.findings import Document, number_at

# A combination is accurate when its error exceeds the efficient estimate's by no more than this on
# any sensor, and honest when its errors over its sd do.
ACCURATE, HONEST = 1.1, 1.2
# Among those, as robust as the most robust within so many standard errors of the difference (the
# rule of one standard error, Breiman et al. 1984), and as fast as the fastest within this.
ROBUST, FAST = 1.0, 1.1
# Filters whose memory does not grow, the numerically safe forms first: among equally fast ones, a
# covariance in square-root form cannot lose its definiteness.
ON_BOARD = ("sqrf", "ukf", "ekf")
PLACES: dict[str, tuple[str, ...]] = {
    "ground": (*ON_BOARD, "smoother", "batch"),
    "on_board": ON_BOARD,
}


def choice(document: Document) -> dict[str, Any]:
    """Return the combinations with their worst figures, and the one to use in each place."""
    rows = summaries(document)
    rule = {"accurate": ACCURATE, "honest": HONEST, "robust": ROBUST, "fast": FAST}
    chosen = {place: _best(rows, estimators) for place, estimators in PLACES.items()}
    return {"rule": rule, "summaries": rows, **chosen}


def summaries(document: Document) -> list[dict[str, Any]]:
    """Return each combination's worst figures over the sensors, and its robustness."""
    columns = [sensor["combinations"] for sensor in document["sensors"].values()]
    runs = document["robustness"]["runs"]
    return [
        _summary(measured, robust, runs)
        for *measured, robust in zip(*columns, document["robustness"]["combinations"], strict=True)
    ]


def _summary(measured: Sequence[Document], robust: Document, runs: int) -> dict[str, Any]:
    def column(key: str) -> np.ndarray[Any, np.dtype[np.float64]]:
        return np.array([number_at(item, key) for item in measured])

    ends = [*robust["starts"]["well"], *robust["false_matches"]["well"]]
    accuracy, honesty = float(column("over_efficient").max()), float(column("honesty").max())
    refused, share = int(column("refused").sum()), float(np.mean(ends))
    return {
        "residual": robust["residual"],
        "estimator": robust["estimator"],
        "over_efficient": number(accuracy),
        "honesty": number(honesty),
        "us_per_frame": number(float(np.exp(np.log(column("us_per_frame")).mean()))),
        "refused": refused,
        "robust": number(share),
        "robust_sd": number(float(np.sqrt(share * (1.0 - share) / (runs * len(ends))))),
        "eligible": bool(accuracy <= ACCURATE and honesty <= HONEST and refused == 0),
    }


def _best(rows: Sequence[Document], estimators: Sequence[str]) -> dict[str, Any] | None:
    """Return the combination to use: of the eligible, the robust, and of those, the fastest."""
    left = [row for row in rows if row["eligible"] and row["estimator"] in estimators]
    if not left:
        return None
    most = max(left, key=lambda row: float(row["robust"]))
    left = [row for row in left if _as_robust(row, most)]
    fastest = min(row["us_per_frame"] for row in left)
    left = [row for row in left if row["us_per_frame"] <= FAST * fastest]
    first = min(left, key=lambda row: (estimators.index(row["estimator"]), row["us_per_frame"]))
    return dict(first)


def _as_robust(row: Document, most: Document) -> bool:
    sd = float(np.hypot(row["robust_sd"], most["robust_sd"]))
    return bool(most["robust"] - row["robust"] <= ROBUST * sd)
