"""Which findings of Wu et al. 2019, Test 3, hold: angular distances against singular values."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.studies import wu_claims as claims
from stcal.studies.findings import (
    FAILS,
    HOLDS,
    PARTLY,
    Document,
    listed,
    number_at,
    out_of,
    verdict_of,
)
from stcal.studies.wu_comparison import column, criterion, if_runs, is_above
from stcal.studies.wu_paper import AD, GROUP, GROUPS, SVD

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# "As accurate": the paper's own ratios are 0.7 to 1.11.
_ALIKE = 1.15
# "Significantly shorter", in its smallest group by 41 %.
_MUCH_FASTER = 0.7
# Figure 6: images until criterion A stays below this, and their ratio between the methods.
_SETTLED_ARCSEC = 1.0
_SIMILAR, _FAR = 1.5, 3.0


def accuracy_is_alike(document: Document) -> dict[str, str]:
    """Table 4, mean of criterion A."""
    ratio, constant = (_ratios(document, "a"), _ratios(document, "constant_r"))
    paper = _published_ratios(document, "a", "mean")
    near = ratio <= _ALIKE
    here = (
        f"Groups 1, 2, 3: SVD / AD is {listed(ratio, 3, signed=False)}, in Table 4 "
        f"{listed(paper, 3, signed=False)}; up to {_ALIKE:g} in {out_of(near)} groups. With "
        f"constant R, AD from all pairs: {listed(constant, 3, signed=False)}."
    )
    return claims.ACCURACY_ALIKE.judged(if_runs(document, verdict_of(near)), here)


def values_are_more_stable(document: Document) -> dict[str, str]:
    """Table 4, sd of criterion A over images."""
    smaller = _wins(document, "sd over images")
    sd = {method: _means(document, method, "a", "sd") for method in (AD, SVD)}
    runs = {method: _means(document, method, "a", "mean", np.std) for method in (AD, SVD)}
    here = (
        f"Groups 1, 2, 3: the sd over images is {listed(sd[SVD], 3, signed=False)} arcsec with "
        f"SVD, {listed(sd[AD], 3, signed=False)} with AD; smaller beyond chance with SVD in "
        f"{out_of(smaller)} groups. Over runs criterion A has an sd of "
        f"{listed(runs[SVD], 3, signed=False)} with SVD, {listed(runs[AD], 3, signed=False)} with "
        "AD."
    )
    return claims.MORE_STABLE.judged(if_runs(document, _any_or_all(smaller)), here)


def values_fit_noise_less(document: Document) -> dict[str, str]:
    """Table 4, mean of criterion B."""
    pairs = [[criterion(group, m, name="b") for m in (SVD, AD)] for group in _groups(document)]
    above = np.array([is_above(svd, ad) for svd, ad in pairs])
    excess = np.array([100.0 * (svd.mean() / ad.mean() - 1.0) for svd, ad in pairs])
    paper = 100.0 * (_published_ratios(document, "b", "mean") - 1.0)
    here = (
        f"Groups 1, 2, 3: SVD is above AD by {listed(excess, 3, '%')}, in Table 4 by "
        f"{listed(paper, 2, '%')}; beyond chance in {out_of(above)} groups."
    )
    return claims.NOISE_FITTED_LESS.judged(if_runs(document, _any_or_all(above)), here)


def values_are_faster(document: Document) -> dict[str, str]:
    """Table 4, time per image."""
    ratio = np.array(
        [
            number_at(group, "methods", SVD, "us_settled")
            / number_at(group, "methods", AD, "us_settled")
            for group in _groups(document)
        ]
    )
    less = ratio <= _MUCH_FASTER
    paper = np.array([_published(document, g, SVD) / _published(document, g, AD) for g in GROUPS])
    here = (
        f"Groups 1, 2, 3: SVD takes {listed(ratio, 2, signed=False)} times the time of AD, in "
        f"Table 4 {listed(paper, 2, signed=False)} times. Both run compiled in the same filter."
    )
    return claims.FASTER.judged(_any_or_all(less), here)


def _published(document: Document, group: int, method: str) -> float:
    return number_at(document["paper"]["groups"][str(group)], "methods", method, "us_per_image")


def convergence_is_alike(document: Document) -> dict[str, str]:
    """Figure 6."""
    found = document["groups"][str(GROUP)]["convergence"]
    images = np.array([_settled(column(found, "image"), found, m) for m in (AD, SVD)])
    ratio = float(images.max() / images.min())
    verdict = FAILS
    if ratio <= _SIMILAR:
        verdict = HOLDS
    elif ratio <= _FAR:
        verdict = PARTLY
    ad, svd = (f"{n:.0f}" if math.isfinite(n) else "none" for n in images)
    here = (
        f"Criterion A, root mean square over the runs, stays below {_SETTLED_ARCSEC:g} arcsec from "
        f"image {ad} on with AD, from image {svd} on with SVD."
    )
    return claims.CONVERGENCE_ALIKE.judged(verdict, here)


def _settled(image: Floats, found: Document, method: str) -> float:
    """Return the image from which on the curve is below the limit, NaN when it never is."""
    curve = column(found, "a", method)
    above = np.flatnonzero(~(curve <= _SETTLED_ARCSEC))
    place = int(above[-1]) + 1 if len(above) else 0
    return float(image[place]) if place < len(image) else math.nan


def _groups(document: Document) -> list[Document]:
    return [document["groups"][str(group)] for group in GROUPS]


def _ratios(document: Document, name: str) -> Floats:
    """Return SVD's criterion over AD's in each group."""
    return _means(document, SVD, name, "mean") / _means(document, AD, name, "mean")


def _means(
    document: Document,
    method: str,
    name: str,
    key: str,
    statistic: Callable[[Floats], np.floating[Any]] = np.mean,
) -> Floats:
    """Return a statistic over runs of a method's criterion in each group."""
    return np.array([statistic(criterion(g, method, key, name)) for g in _groups(document)])


def _published_ratios(document: Document, *keys: str) -> Floats:
    papers = [document["paper"]["groups"][str(group)] for group in GROUPS]
    values = [[number_at(p, "methods", m, *keys) for m in (SVD, AD)] for p in papers]
    svd, ad = np.array(values).T
    return np.asarray(svd / ad)


def _wins(document: Document, what: str) -> Bools:
    rows = [row for row in document["comparison"]["wins"] if row["what"] == what]
    return np.array([row["winner"] == SVD for row in rows])


def _any_or_all(hits: Bools) -> str:
    """Return the verdict on a claim about all groups, partly true with any."""
    return verdict_of(hits, bool(hits.any()))
