"""What the numbers of the study ``wu`` say beyond the paper's own findings.

How near the filters come to what the data allow, whether the singular values win anything, how the
time grows, and what the published numbers themselves imply.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.pipeline.numbers import number
from stcal.studies.findings import OPEN, Document, number_at
from stcal.studies.wu_paper import AD, SVD

Floats = NDArray[np.float64]

NEITHER = "neither"
# A difference counts when it exceeds so many of its standard errors, one of times this share.
_SIGNIFICANT, _FASTER = 2.0, 0.05
_RESAMPLES, _LEAST_RUNS = 1000, 3


def column(document: Document, *keys: str) -> Floats:
    """Return the numbers of all runs (R,) at a path of keys, NaN where one is missing."""
    found: Any = document
    for key in keys:
        found = found.get(key, {}) if isinstance(found, Mapping) else {}
    values = found if isinstance(found, list) else []
    return np.array([math.nan if v is None else v for v in values], dtype=np.float64)


def criterion(group: Document, method: str, key: str = "mean", name: str = "a") -> Floats:
    """Return a method's criterion in each run (R,): ``mean`` or ``sd`` over images, arcsec."""
    return column(group, "methods", method, name, key)


def difference(
    one: Floats, other: Floats, statistic: Callable[..., Any] = np.mean
) -> tuple[float, float]:
    """Return the difference of a statistic over runs (R,) and its standard error.

    The runs of both are the same: they are resampled together (Efron 1979).  NaN for the error of
    fewer than three runs.
    """
    if len(one) == 0 or len(one) != len(other):
        return math.nan, math.nan
    found = float(statistic(one) - statistic(other))
    if len(one) < _LEAST_RUNS:
        return found, math.nan
    which = np.random.default_rng(0).integers(len(one), size=(_RESAMPLES, len(one)))
    resampled = statistic(one[which], axis=1) - statistic(other[which], axis=1)
    return found, float(np.std(resampled))


def is_above(one: Floats, other: Floats, statistic: Callable[..., Any] = np.mean) -> bool:
    """Whether a statistic of one is above that of the other beyond chance."""
    found, sd = difference(one, other, statistic)
    return found > _SIGNIFICANT * sd


def if_runs(document: Document, verdict: str) -> str:
    """Return the verdict, open when the runs are too few to tell luck from skill."""
    return verdict if number_at(document, "runs") >= _LEAST_RUNS else OPEN


def comparison(document: Document) -> dict[str, Any]:
    """Return what the document's groups say, with the paper's numbers beside."""
    groups, paper = document["groups"], document["paper"]["groups"]
    return {
        "against_bound": {name: _against_bound(group) for name, group in groups.items()},
        "wins": _wins(groups),
        "growth": {
            "here": _growth(groups, "us_settled"),
            "paper": _growth(paper, "us_per_image"),
        },
        "published": {name: _published(document, name) for name in groups},
    }


def _against_bound(group: Document) -> dict[str, Any]:
    """Return criterion A of each method over that of the efficient estimate of the same data.

    ``expected`` is what the residual's own information allows.
    """
    efficient, bound = column(group, "efficient", "mean"), number_at(group, "bound", "mean")
    rows = {}
    for method in (AD, SVD):
        found = criterion(group, method)
        ratio = float(found.mean() / efficient.mean())
        _, sd = difference(found, ratio * efficient)
        expected = number_at(group, "methods", method, "expected", "mean") / bound
        rows[method] = {
            "ratio": number(ratio),
            "sd": number(sd / float(efficient.mean())),
            "expected": number(expected),
        }
    return rows


def _wins(groups: Document) -> list[dict[str, Any]]:
    """Return who wins: accuracy, stability over images and over runs, and time, by group."""
    tests: tuple[tuple[str, str, Callable[..., Any]], ...] = (
        ("accuracy", "mean", np.mean),
        ("sd over images", "sd", np.mean),
        ("sd over runs", "mean", np.std),
    )
    found = [
        {"what": what, "group": name, **_better(group, key, statistic)}
        for what, key, statistic in tests
        for name, group in groups.items()
    ]
    return found + [
        {"what": "time", "group": name, **_faster(group)} for name, group in groups.items()
    ]


def _better(group: Document, key: str, statistic: Callable[..., Any]) -> dict[str, Any]:
    ad, svd = (criterion(group, method, key) for method in (AD, SVD))
    winner = _less(ad, svd, statistic)
    return {AD: number(float(statistic(ad))), SVD: number(float(statistic(svd))), "winner": winner}


def _less(ad: Floats, svd: Floats, statistic: Callable[..., Any]) -> str:
    if is_above(svd, ad, statistic):
        return AD
    return SVD if is_above(ad, svd, statistic) else NEITHER


def _faster(group: Document) -> dict[str, Any]:
    times = {m: number_at(group, "methods", m, "us_settled") for m in (AD, SVD)}
    fastest = min(times, key=lambda m: times[m])
    clear = times[fastest] < (1.0 - _FASTER) * max(times.values())
    return {m: number(t) for m, t in times.items()} | {"winner": fastest if clear else NEITHER}


def _growth(groups: Document, key: str) -> dict[str, Any]:
    """Return by which power of the number of stars the time grows: a line through logarithms."""
    stars = np.array([number_at(group, "stars") for group in groups.values()])
    return {
        method: number(_slope(stars, [
            number_at(group, "methods", method, key) for group in groups.values()
        ]))
        for method in (AD, SVD)
    }  # fmt: skip


def _slope(stars: Floats, times: list[float]) -> float:
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = np.log(stars), np.log(np.array(times))
    known = np.isfinite(x) & np.isfinite(y)
    return float(np.polyfit(x[known], y[known], 1)[0]) if known.sum() > 1 else math.nan


def _published(document: Document, name: str) -> dict[str, Any]:
    """Return what the published criteria of a group imply.

    Criterion B is nearly all centroid noise, to which it is proportional: ``noise_px`` is the noise
    that the published one shows.  ``over_bound`` is the published criterion A over the bound at the
    stated noise, ``over_bound_at_noise`` at the noise shown; ``luck`` the share of runs at the
    bound, with the stated noise, that do as well or better.
    """
    group, paper = document["groups"][name], document["paper"]["groups"][name]["methods"]
    stated, bound = number_at(document, "settings", "noise_sd_px"), group["bound"]
    shown = stated * paper[AD]["b"]["mean"] / float(criterion(group, AD, name="b").mean())
    rows = {}
    for method in (AD, SVD):
        ratio = paper[method]["a"]["mean"] / number_at(bound, "mean")
        rows[method] = {
            "over_bound": number(ratio),
            "over_bound_at_noise": number(ratio * stated / shown),
            "luck": number(share_below(bound, paper[method]["a"]["mean"])),
        }
    return {"noise_px": number(shown), **rows}


def share_below(distribution: Document, value: float) -> float:
    """Return the share of runs at or below a value, from a distribution's percentiles."""
    percentiles = column(distribution, "percentiles")
    shares = np.linspace(0.0, 1.0, len(percentiles))
    return float(np.interp(value, percentiles, shares))
