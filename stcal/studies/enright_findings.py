"""Which findings of Enright 2018 hold in a run of the study: those on the tables' numbers.

Each is decided from the numbers alone.  Where the paper publishes the same numbers, the same rule
is applied to them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.studies import enright_filter_findings as filters
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
Bools = NDArray[np.bool_]

# The paper's fall of the RMS in percent: Table IV, rounded outwards.
_FALL_PERCENT = (20.0, 80.0)
# "Within a few percent", and "similar".
_FEW_PERCENT = 5.0
# An error counts as higher from here on.
_HIGHER_PERCENT = 1.0
# The reduced model's excess in percent, section III-B.
_REDUCED_PERCENT = (5.0, 13.0)

_BATCH = Claim(
    "Batch recalibration improves availability, matches and error",
    "III-A, IV",
    "Availability rises or stays, the matched star ratio is 1 or more, and the RMS falls, typically"
    " by 30 to 70 % (Table IV: by 25 to 81 %).",
    {
        HOLDS: "A camera closer to the truth leaves less error in every star vector, so that more "
        "of the matching's geometry checks pass.",
        PARTLY: "Everything improves, but the error by another amount than in the paper: it is "
        "compared on pairs that only the fitted camera identifies, where the initial one errs most,"
        " and it depends on the laboratory calibrations, which are not published.",
        FAILS: "The calibration data of this run are too few or too poor for some sensor.",
    },
)
_NO_Q = Claim(
    "The filter without process noise does as well as the batch fit",
    "III-B.1, III-C",
    "On validation data the No-Q filter comes very close to the batch fit for most sensors, within "
    "a few percent.",
    {
        HOLDS: "Without process noise the filter is least squares, frame by frame, on the same "
        "arcs; with white noise and an exact model both end at the same minimum.",
        PARTLY: "Some filters have not converged by the last frame; more calibration data would "
        "remove the excess.",
        FAILS: "Most filters have not converged by the last frame.",
    },
)
_NO_REFIT = Claim(
    "Without rematching the error is higher",
    "III-B.1",
    "For most sensors the No-Refit filter's error is higher than that of both rematching filters.",
    {
        HOLDS: "The initial camera identifies only the stars that it places nearly right, and they "
        "pull the estimate back towards it; a sensor whose initial camera already identifies all "
        "stars loses nothing.",
        PARTLY: "Only sensors whose initial camera misses many stars lose by keeping its matches.",
        FAILS: "The initial cameras of this run identify enough stars on their own.",
    },
)
_Q = Claim(
    "Process noise changes the error little",
    "III-B.1, III-C",
    "The Q filter's errors are similar to the No-Q filter's: process noise is not needed unless "
    "parameters drift within an orbit.",
    {
        HOLDS: "The simulated parameters are constant; process noise only makes the filter forget "
        "old frames, which costs a little accuracy.",
        PARTLY: "Forgetting old frames costs some sensors more than a few percent.",
        FAILS: "This much process noise makes the filter forget too much of what it has seen.",
    },
)
_REDUCED = Claim(
    "A model of focal length and principal point alone is 5 to 13 % worse",
    "III-B.1",
    "The RMS of the reduced models is 5 to 13 % above that of the full ones; row 1R of Table V is "
    "said to be typical.",
    {
        HOLDS: "Three parameters absorb most of what has changed.",
        PARTLY: "Three parameters absorb what has changed in some sensors only.",
        FAILS: "The simulated sensors also change in distortion, tilt and aspect, by what Table III"
        " says; three parameters cannot absorb that. Table V's own row 1R does not support the "
        "statement either.",
    },
)


def findings(sensors: Sequence[Document]) -> list[dict[str, str]]:
    """Return the nine findings, judged by the numbers of the sensors' studies."""
    tests: tuple[Callable[[Sequence[Document]], dict[str, Any]], ...] = (
        batch_improves,
        no_q_equals_batch,
        no_refit_is_worse,
        q_equals_no_q,
        reduced_is_worse,
        filters.start_is_forgotten,
        filters.q_wanders,
        filters.radial_curve_agrees,
        filters.availability_first,
    )
    return [test(sensors) for test in tests]


def batch_improves(sensors: Sequence[Document]) -> dict[str, str]:
    """Finding 1, Table IV."""
    better, fall = _improved(sensors)
    low, high = _FALL_PERCENT
    usual = (fall >= low) & (fall <= high)
    published = _improved([sensor["paper"] for sensor in sensors])
    own = -_excess(sensors, "batch", "raw", "calibration", "own_rms_urad")
    here = (
        f"Availability and matched stars rise or stay for {out_of(better)} sensors. "
        f"{named(sensors)}: the RMS over common pairs falls by {listed(fall, 0, '%', False)}; in "
        f"Table IV by {listed(published[1], 0, '%', False)}. With each camera over the pairs that "
        f"it identifies itself, it falls by {listed(own, 0, '%', False)} here."
    )
    return _BATCH.judged(verdict_of(better & usual, bool((better & (fall >= low)).all())), here)


def _improved(documents: Sequence[Document]) -> tuple[Bools, Floats]:
    """Where availability and matches don't fall, and the fall of the RMS in percent."""
    raw, batch, ratio = (
        np.array([_of(document, "calibration", *path) for document in documents])
        for path in (
            ("raw", "availability"),
            ("batch", "availability"),
            ("batch", "matched_star_ratio"),
        )
    )
    fall = -_excess(documents, "batch", "raw", part="calibration")
    return (batch >= raw) & (ratio >= 1.0), fall


def no_q_equals_batch(sensors: Sequence[Document]) -> dict[str, str]:
    """Finding 2, Table V."""
    return _alike(_NO_Q, sensors, "no_q", "batch")


def q_equals_no_q(sensors: Sequence[Document]) -> dict[str, str]:
    """Finding 4, Table V."""
    return _alike(_Q, sensors, "q", "no_q")


def _alike(claim: Claim, sensors: Sequence[Document], one: str, other: str) -> dict[str, str]:
    """Judge that two methods' errors differ by a few percent at most."""
    excess, published = _both_excesses(sensors, one, other)
    near, also = (np.abs(found) <= _FEW_PERCENT for found in (excess, published))
    here = (
        f"{named(sensors)}: the RMS differs by {listed(excess, 1, '%')}; within "
        f"{_FEW_PERCENT:g} % for {out_of(near)} sensors. By the same rule Table V gives "
        f"{out_of(also)}."
    )
    return claim.judged(verdict_of(near), here)


def no_refit_is_worse(sensors: Sequence[Document]) -> dict[str, str]:
    """Finding 3, Table V."""
    pairs = [_both_excesses(sensors, "no_refit", other) for other in ("q", "no_q")]
    # Above the better of the two is no feat: the claim is on both.
    excess, published = (np.minimum(*both) for both in zip(*pairs, strict=True))
    worse, also = (found > _HIGHER_PERCENT for found in (excess, published))
    here = (
        f"{named(sensors)}: the RMS exceeds that of the worse rematching filter by "
        f"{listed(excess, 1, '%')}; by more than {_HIGHER_PERCENT:g} % for {out_of(worse)} "
        f"sensors. By the same rule Table V gives {out_of(also)}."
    )
    return _NO_REFIT.judged(most(worse), here)


def most(hits: Bools) -> str:
    """Return the verdict on a claim about most sensors."""
    if not len(hits):
        return OPEN
    if 2 * hits.sum() > len(hits):
        return HOLDS
    return PARTLY if hits.any() else FAILS


def reduced_is_worse(sensors: Sequence[Document]) -> dict[str, str]:
    """Finding 5, Table V."""
    excess, published = _both_excesses(sensors, "batch_reduced", "batch")
    low, high = _REDUCED_PERCENT
    within = (excess >= low) & (excess <= high)
    here = (
        f"{named(sensors)}: the RMS of the reduced batch fit exceeds that of the full one by "
        f"{listed(excess, 0, '%')}; by {low:g} to {high:g} % for {out_of(within)} sensors."
    )
    known = np.isfinite(published)
    if known.any():
        rows = [sensor for sensor, is_known in zip(sensors, known, strict=True) if is_known]
        here += f" In Table V ({named(rows)}): {listed(published[known], 0, '%')}."
    return _REDUCED.judged(verdict_of(within), here)


def _both_excesses(sensors: Sequence[Document], one: str, other: str) -> tuple[Floats, Floats]:
    """Excess of the validation RMS in percent, here and in the paper."""
    papers = [sensor["paper"] for sensor in sensors]
    return _excess(sensors, one, other), _excess(papers, one, other)


def _excess(
    documents: Sequence[Document],
    one: str,
    other: str,
    part: str = "validation",
    key: str = "rms_urad",
) -> Floats:
    """By how much one camera's RMS exceeds another's, in percent."""
    above, below = (
        np.array([_of(document, part, name, key) for document in documents])
        for name in (one, other)
    )
    return np.asarray(100.0 * (above / below - 1.0))


def _of(document: Document, part: str, camera: str, key: str) -> float:
    return number_at(document, part, "cameras", camera, key)
