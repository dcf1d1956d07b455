"""Which findings of Wu et al. 2019 hold in a run of the study, after what the study adds to them.

Each is decided from the numbers alone.  Accuracies are means over runs; differences count beyond
two standard errors, so that fewer than three runs leave most findings open.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from stcal.report.format import fixed, percent
from stcal.report.wu_content import MODELS, VALUES
from stcal.studies import wu_bound_findings as bounds
from stcal.studies import wu_claims as claims
from stcal.studies import wu_method_findings as methods
from stcal.studies.findings import FAILS, HOLDS, PARTLY, Document, number_at, verdict_of
from stcal.studies.wu_comparison import criterion, if_runs, is_above
from stcal.studies.wu_paper import GROUP, MODEL, SVD, model_key, values_key

Floats = NDArray[np.float64]

# The share of images that "most" are.
_MOST = 0.5
# Where the document has Figure 3's shares, by the order of an image's stars.
_ORDERS = {
    "by brightness": "best_model",
    "from the principal point outwards": "best_model_outward",
}
# Methods of Table 3 by the combinations that the paper finds best.
_BEST = tuple(values_key(values) for values in ((1, 2, 3), (2, 3), (2,)))
_ALONE = values_key((2,))
# A combination this much above the best one is as good.
_AS_GOOD = 1.05


def findings(document: Document) -> list[dict[str, str]]:
    """Return the findings, judged by the numbers: five of the study's own, ten of the paper's."""
    tests: tuple[Callable[[Document], dict[str, str]], ...] = (
        bounds.reaches_bound,
        bounds.values_win,
        bounds.time_is_linear,
        bounds.published_is_above_bound,
        bounds.published_is_lucky,
        model_observes_best,
        first_value_observes_least,
        model_is_most_accurate,
        combinations_are_best,
        one_value_is_unstable,
        methods.accuracy_is_alike,
        methods.values_are_more_stable,
        methods.values_fit_noise_less,
        methods.values_are_faster,
        methods.convergence_is_alike,
    )
    return [test(document) for test in tests]


def model_observes_best(document: Document) -> dict[str, str]:
    """Figure 3, with stars in two orders: the paper doesn't give its own."""
    shares = {order: _shares(document, key) for order, key in _ORDERS.items()}
    hits = np.array([found[str(MODEL)] > _MOST for found in shares.values()])
    parts = [f"with stars {order}, {_named(found, 'Model ')}" for order, found in shares.items()]
    here = f"Best are, {'; '.join(parts)} of {_images(document)} images."
    return claims.MODEL_OBSERVABLE.judged(verdict_of(hits, bool(hits.any())), here)


def first_value_observes_least(document: Document) -> dict[str, str]:
    """Figure 4."""
    shares = _shares(document, "worst_value")
    verdict = FAILS
    if shares["1"] > _MOST:
        verdict = HOLDS
    elif shares["1"] >= max(shares.values()):
        verdict = PARTLY
    here = f"Worst are {_named(shares, 'σ')} of {_images(document)} images."
    return claims.VALUE_OBSERVABLE.judged(verdict, here)


def _shares(document: Document, key: str) -> dict[str, float]:
    cases = document["observability"][key]
    return {case: number_at(cases, case) for case in cases}


def _named(shares: dict[str, float], prefix: str) -> str:
    return ", ".join(f"{prefix}{case} in {percent(share)}" for case, share in shares.items())


def _images(document: Document) -> str:
    return f"{number_at(document, 'observability', 'images'):.0f}"


def model_is_most_accurate(document: Document) -> dict[str, str]:
    """Table 2."""
    found = _accuracies(document, list(MODELS))
    claimed = model_key(MODEL)
    others = [runs for name, runs in found.items() if name != claimed]
    verdict = PARTLY
    if all(is_above(runs, found[claimed]) for runs in others):
        verdict = HOLDS
    elif claimed != _best(found):
        verdict = FAILS
    here = f"Criterion A, mean over runs: {_listed(found, MODELS)}. {_constant(document, MODELS)}"
    return claims.MODEL_ACCURATE.judged(if_runs(document, verdict), here)


def combinations_are_best(document: Document) -> dict[str, str]:
    """Table 3."""
    found = _accuracies(document, list(VALUES))
    good = _as_good(found)
    order = sorted(found, key=lambda name: float(found[name].mean()))
    verdict = FAILS
    if set(order[: len(_BEST)]) == set(_BEST):
        verdict = HOLDS
    elif good.issuperset(_BEST[:2]):
        verdict = PARTLY
    here = (
        f"Criterion A, mean over runs: {_listed(found, VALUES)}. As good as the best, "
        f"within chance or {100 * (_AS_GOOD - 1):.0f} %: "
        f"{', '.join(label for name, label in VALUES.items() if name in good)}. "
        f"{_constant(document, VALUES)}"
    )
    return claims.VALUE_ACCURATE.judged(if_runs(document, verdict), here)


def one_value_is_unstable(document: Document) -> dict[str, str]:
    """Table 3, sd."""
    group = _tested(document)
    sd_alone, sd_both = (criterion(group, name, "sd") for name in (_ALONE, SVD))
    alone, both = (criterion(group, name) for name in (_ALONE, SVD))
    hits = (is_above(sd_alone, sd_both), is_above(alone, both, np.std))
    verdict = HOLDS if all(hits) else PARTLY if any(hits) else FAILS
    here = (
        f"Its sd is {fixed(sd_alone.mean(), 3)} against {fixed(sd_both.mean(), 3)} arcsec over "
        f"images, {fixed(alone.std(), 3)} against {fixed(both.std(), 3)} arcsec over runs."
    )
    return claims.ALONE_UNSTABLE.judged(if_runs(document, verdict), here)


def _tested(document: Document) -> Document:
    group: Document = document["groups"][str(GROUP)]
    return group


def _accuracies(document: Document, names: list[str], key: str = "a") -> dict[str, Floats]:
    """Return criterion A (R,) in each run by method, in the group of the paper's tests 1 and 2."""
    return {name: criterion(_tested(document), name, name=key) for name in names}


def _best(found: dict[str, Floats]) -> str:
    return min(found, key=lambda name: float(found[name].mean()))


def _as_good(found: dict[str, Floats]) -> set[str]:
    """Return the methods whose mean is near the best one's, or above it by chance only."""
    best = found[_best(found)]
    return {
        name
        for name, runs in found.items()
        if runs.mean() <= _AS_GOOD * best.mean() or not is_above(runs, best)
    }


def _listed(found: dict[str, Floats], labels: dict[str, str]) -> str:
    shown = ", ".join(f"{labels[name]} {fixed(runs.mean(), 3)}" for name, runs in found.items())
    return f"{shown} arcsec"


def _constant(document: Document, labels: dict[str, str]) -> str:
    """Say what constant R gives."""
    found = _accuracies(document, list(labels), "constant_r")
    return f"With constant R {labels[_best(found)]} is the best: {_listed(found, labels)}."
