"""Cycles of rematching and refitting, Enright 2018 section II-C."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from stcal.calibration import Calibration
from stcal.cameras import Camera
from stcal.estimators.batch import BatchSolution
from stcal.execution import OrderedMap
from stcal.matching import Matcher
from stcal.pipeline.figures import arc_sums
from stcal.pipeline.fitting import Fitting, Kept, fit_camera, forget
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

    ``fitting`` has kept its stars; ``rms`` [rad] is that of an even sample of the fragments (all of
    them when they are few).
    """

    fitting: Fitting
    matching: str
    identified: Identified
    kept: Kept
    solution: BatchSolution
    camera: Camera
    rms: float

    @property
    def name(self) -> str:
        """What its arrays are kept under."""
        return self.fitting.cycle

    @property
    def noise_scale(self) -> float:
        """Sd of the residuals over that of the noise model, NaN without redundancy."""
        dof = self.solution.information.rows - len(self.solution.parameters)
        return float(np.sqrt(self.solution.chi2 / dof)) if dof > 0 else float("nan")


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
    """
    camera, before = initial.camera, None
    cycles: list[Cycle] = []
    for number in range(1, matcher.config.fit.maximum_cycles + 1):
        identify = Identify(
            scratch=scratch, matcher=matcher, camera=camera, c_sd=initial.c_sd,
            cycle=f"cycle {number}", method=matches if before is None else _later(matches),
            before=before, step=series_step(pieces),
        )  # fmt: skip
        cycle = _one_cycle(identify, pieces, residual, free, mapper)
        if before is not None:
            _forget(scratch, before)
        cycles.append(cycle)
        on_cycle(cycle)
        if not np.isfinite(cycle.camera.parameters).all() or not cycle.kept.rows:
            return cycles, False
        found = cycle.identified
        settled = found.changed <= _SETTLED_SHARE * max(found.matched_stars, 1)
        if before is not None and settled:
            return cycles, True
        camera, before = cycle.camera, cycle.name
    return cycles, False


def _later(matches: str) -> str:
    return "lost-in-space" if matches == "lost-in-space" else "guided"


def _one_cycle(
    identify: Identify, pieces: Sequence[Piece], residual: Residual, free: Ints, mapper: OrderedMap
) -> Cycle:
    identified = total(mapper(identify, pieces))
    scratch, config = identify.scratch, identify.matcher.config
    start = Fitting(scratch, identify.cycle, config, residual, free)
    fitted = fit_camera(start, pieces, identify.camera, identified.departures, mapper)
    arcs = partial(arc_sums, fitting=fitted.fitting, cameras=(fitted.camera,))
    return Cycle(
        fitting=fitted.fitting,
        matching=identify.method,
        identified=identified,
        kept=fitted.kept,
        solution=fitted.solution,
        camera=fitted.camera,
        rms=float(total(mapper(arcs, thinned(pieces))).rms_rad[0]),
    )


def _forget(scratch: Scratch, cycle: str) -> None:
    """Forget what only the next cycle needed."""
    for what in ("matches", "stars", "exposures"):
        scratch.drop(f"{cycle} {what}")
    forget(scratch, cycle)
