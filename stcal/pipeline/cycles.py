"""Cycles of rematching and refitting, Enright 2018 section II-C."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from stcal.calibration import Calibration
from stcal.execution import OrderedMap
from stcal.matching import Matcher
from stcal.pipeline.figures import ArcSums, arc_sums
from stcal.pipeline.fitting import Fitted, Fitting, fit_camera, forget
from stcal.pipeline.identifying import Identified, Identify, series_step
from stcal.pipeline.pieces import Piece, thinned
from stcal.pipeline.scratch import Scratch
from stcal.pipeline.sums import total
from stcal.residuals import Residual

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Matches that may still flicker at the tolerance's edge when the set counts as settled.
_SETTLED_SHARE = 1e-3


@dataclass(frozen=True)
class Cycle:
    """What one cycle of matching and fitting did.

    ``rms`` [rad] is that of an even sample of the fragments (all of them when they are few).
    """

    matching: str
    identified: Identified
    fitted: Fitted
    rms: float

    @property
    def name(self) -> str:
        """What its arrays are kept under."""
        return self.fitted.fitting.cycle

    @property
    def noise_scale(self) -> float:
        """Sd of the residuals over that of the noise model, NaN without redundancy."""
        dof = self.fitted.solution.information.rows - len(self.fitted.solution.parameters)
        return float(np.sqrt(self.fitted.solution.chi2 / dof)) if dof > 0 else float("nan")


def run_cycles(
    pieces: Sequence[Piece],
    initial: Calibration,
    matcher: Matcher,
    matches: str,
    residual: Residual,
    free: Ints,
    scratch: Scratch,
    mapper: OrderedMap,
    on_cycle: Callable[[Cycle], None],
) -> tuple[list[Cycle], bool]:
    """Match and fit until the matched set settles; return the cycles and whether it did.

    ``matches`` says where the first cycle's matches come from: ``telemetry`` or a matching method.
    ``free`` are the places of the parameters to estimate; the others keep their initial values.
    Later cycles rematch with the latest camera: lost in space if the first was, else guided by the
    previous matches.  ``scratch`` keeps the first cycle's attitudes and the last cycle's stars.

    A camera that is only matched with is fitted to an even sample of many fragments, the last one
    to all: which is the last is known when its matches are.
    """
    camera, before = initial.camera, None
    cycles: list[Cycle] = []
    most = matcher.config.fit.maximum_cycles
    for number in range(1, most + 1):
        identify = Identify(
            scratch=scratch, matcher=matcher, camera=camera, c_sd=initial.c_sd,
            cycle=f"cycle {number}", method=matches if before is None else _later(matches),
            before=before, step=series_step(pieces),
        )  # fmt: skip
        identified = total(mapper(identify, pieces))
        settled = before is not None and _settled(identified)
        roughly = not settled and number < most
        cycle = _fitted(identify, identified, pieces, residual, free, mapper, roughly)
        if before is not None:
            _forget(scratch, before)
        cycles.append(cycle)
        on_cycle(cycle)
        if settled or not cycle.fitted.usable:
            break
        camera, before = cycle.fitted.camera, cycle.name
    return cycles, settled


def change_in_sd(cycles: Sequence[Cycle], which: int, covariance: Floats) -> float:
    """Return the largest change of a parameter by a cycle, in sd; infinite for the first.

    That of the even sample's camera, which every cycle has; ``covariance`` (P, P) gives the sd, NaN
    where the estimator found none.
    """
    which %= len(cycles)
    if which == 0:
        return float("inf")
    before, after = (cycles[k].fitted.sampled.parameters for k in (which - 1, which))
    free = cycles[which].fitted.fitting.free
    sd = np.sqrt(np.diag(covariance))[free]
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.max(np.abs(after - before)[free] / sd))


def _later(matches: str) -> str:
    return "lost-in-space" if matches == "lost-in-space" else "guided"


def _settled(identified: Identified) -> bool:
    return identified.changed <= _SETTLED_SHARE * max(identified.matched_stars, 1)


def _fitted(
    identify: Identify,
    identified: Identified,
    pieces: Sequence[Piece],
    residual: Residual,
    free: Ints,
    mapper: OrderedMap,
    roughly: bool,
) -> Cycle:
    config, departures = identify.matcher.config, identified.departures
    start = Fitting(identify.scratch, identify.cycle, config, residual, free)
    fitted = fit_camera(start, pieces, identify.camera, departures, mapper, roughly)
    arcs = total(mapper(partial(_arcs, fitted=fitted), thinned(pieces)))
    return Cycle(identify.method, identified, fitted, float(arcs.rms_rad[0]))


def _arcs(piece: Piece, fitted: Fitted) -> ArcSums:
    return arc_sums(fitted.fitting.kept_stars(piece), (fitted.camera,))


def _forget(scratch: Scratch, cycle: str) -> None:
    """Forget what only the next cycle needed."""
    for what in ("matches", "stars", "exposures"):
        scratch.drop(f"{cycle} {what}")
    forget(scratch, cycle)
