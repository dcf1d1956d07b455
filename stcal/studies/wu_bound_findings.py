"""Findings that the study ``wu`` adds: what the data allow, what is reached, what is published."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from stcal.report.format import fixed, percent
from stcal.report.wu_content import plus_minus
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
from stcal.studies.wu_comparison import criterion, if_runs
from stcal.studies.wu_paper import AD, GROUP, GROUPS, SVD

Floats = NDArray[np.float64]

# How much above the efficient estimate's criterion A a filter's may be.
_GOAL = 1.05
# Powers of the number of stars: linear, and clearly less than the pairs'.
_LINEAR, _BELOW_PAIRS = 1.1, 1.5
# A published value leaves a factor of two, and something at all.
_FACTOR_OF_TWO, _CLEARLY_ABOVE = 1.8, 1.2
# Shares of runs as good as a published one that make it lucky, and better than most.
_LUCKY, _MOST = 0.2, 0.5
_LUCKY_GROUP = 3


def reaches_bound(document: Document) -> dict[str, str]:
    """The goal: the filter on angular distances against the efficient estimate."""
    ratio = {method: _by_group(document, method, "ratio") for method in (AD, SVD)}
    sd = _by_group(document, AD, "sd")
    near = ratio[AD] <= _GOAL
    shown = (
        plus_minus(fixed(value, 3), fixed(error, 3))
        for value, error in zip(ratio[AD], sd, strict=True)
    )
    here = (
        f"Groups 1, 2, 3: its criterion A over that of the efficient estimate on the same "
        f"images is {', '.join(shown)}; within {100 * (_GOAL - 1):.0f} % in {out_of(near)} groups. "
        f"Singular values: {listed(ratio[SVD], 3, signed=False)}. Their own information allows "
        f"{listed(_by_group(document, SVD, 'expected'), 3, signed=False)} of the bound."
    )
    return claims.REACHES_BOUND.judged(if_runs(document, verdict_of(near)), here)


def _by_group(document: Document, method: str, key: str) -> Floats:
    against = document["comparison"]["against_bound"]
    return np.array([number_at(against, str(group), method, key) for group in GROUPS])


def values_win(document: Document) -> dict[str, str]:
    """Whether singular values win in accuracy, stability or time, in any group."""
    rows = document["comparison"]["wins"]
    won, lost = ([row for row in rows if row["winner"] == method] for method in (SVD, AD))
    undecided = len(rows) - len(won) - len(lost)
    here = (
        f"Of {len(rows)} comparisons, each method with its full covariance: singular values win "
        f"{_named(won)}; they lose {_named(lost)}; {undecided} are undecided."
    )
    return claims.VALUES_WIN.judged(if_runs(document, HOLDS if won else FAILS), here)


def _named(rows: list[Mapping[str, str]]) -> str:
    """Return which comparisons: ``time (groups 1, 2)``."""
    groups: dict[str, list[str]] = {}
    for row in rows:
        groups.setdefault(row["what"], []).append(row["group"])
    named = (
        f"{what} (group{'s' if len(found) > 1 else ''} {', '.join(found)})"
        for what, found in groups.items()
    )
    return ", ".join(named) or "nothing"


def time_is_linear(document: Document) -> dict[str, str]:
    """Table 4: the growth of AD's time with the number of stars."""
    growth = document["comparison"]["growth"]
    power = number_at(growth, "here", AD)
    verdict = FAILS
    if power <= _LINEAR:
        verdict = HOLDS
    elif power <= _BELOW_PAIRS:
        verdict = PARTLY
    groups = [document["groups"][str(group)] for group in GROUPS]
    stars = np.array([number_at(group, "stars") for group in groups])
    times = np.array([number_at(group, "methods", AD, "us_settled") for group in groups])
    here = (
        f"{listed(times, 1, 'µs', signed=False)} per image with {listed(stars, 1, signed=False)} "
        f"stars: the number of stars to the power {fixed(power)}; singular values "
        f"{fixed(number_at(growth, 'here', SVD))}. By the same fit Table 4 has "
        f"{fixed(number_at(growth, 'paper', AD))} and {fixed(number_at(growth, 'paper', SVD))}."
    )
    return claims.TIME_IS_LINEAR.judged(verdict, here)


def published_is_above_bound(document: Document) -> dict[str, str]:
    """Tables 2 to 4: the recommended case against the bound."""
    ratio = _published(document, GROUP, "over_bound")
    verdict = FAILS
    if ratio >= _FACTOR_OF_TWO:
        verdict = HOLDS
    elif ratio >= _CLEARLY_ABOVE:
        verdict = PARTLY
    group = document["groups"][str(GROUP)]
    found = (criterion(group, SVD).mean(), criterion(group, SVD, name="constant_r").mean())
    own, constant = (fixed(value, 3) for value in found)
    here = (
        f"The bound's mean over runs is {fixed(number_at(group, 'bound', 'mean'), 3)} arcsec: the "
        f"published value is {fixed(ratio)} times it. Singular values reach {own} arcsec here with "
        f"their full covariance, {constant} with constant R. {_noise(document, GROUP)} With that "
        f"noise the ratio would be {fixed(_published(document, GROUP, 'over_bound_at_noise'))}."
    )
    return claims.PUBLISHED_ABOVE_BOUND.judged(verdict, here)


def published_is_lucky(document: Document) -> dict[str, str]:
    """Table 4, group 3: how many runs at the bound are as good as the published one."""
    luck = _published(document, _LUCKY_GROUP, "luck")
    verdict = FAILS
    if luck <= _LUCKY:
        verdict = HOLDS
    elif luck <= _MOST:
        verdict = PARTLY
    group = document["groups"][str(_LUCKY_GROUP)]
    runs = criterion(group, SVD)
    value = number_at(document, "paper", "groups", str(_LUCKY_GROUP), "methods", SVD, "a", "mean")
    ratio = _published(document, _LUCKY_GROUP, "over_bound_at_noise")
    here = (
        f"The bound's mean over runs is {fixed(number_at(group, 'bound', 'mean'), 3)} arcsec; "
        f"{percent(luck)} of the runs at the bound are as good as the published one, and "
        f"{int((runs <= value).sum())} of the {len(runs)} runs of the singular values' filter. "
        f"{_noise(document, _LUCKY_GROUP)} With that noise it would take no luck: the ratio to the "
        f"bound would be {fixed(ratio)}."
    )
    return claims.PUBLISHED_LUCKY.judged(verdict, here)


def _published(document: Document, group: int, key: str) -> float:
    return number_at(document, "comparison", "published", str(group), SVD, key)


def _noise(document: Document, group: int) -> str:
    shown = number_at(document, "comparison", "published", str(group), "noise_px")
    return (
        f"The paper's own criterion B belongs to {fixed(shown)} px of noise, not to the "
        f"{fixed(number_at(document, 'settings', 'noise_sd_px'), 1)} px that it states."
    )
