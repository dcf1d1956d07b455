"""What follows from a solution, whichever estimator found it: observability, alignment, RMS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.calibration import Calibration
from stcal.cameras import Camera
from stcal.estimators.batch import Observability, observability
from stcal.estimators.information import SquareRootInformation
from stcal.execution import OrderedMap
from stcal.matching import Matcher
from stcal.pipeline.alignment import MOST_TURNS, Alignment, update_alignment
from stcal.pipeline.figures import Figures, MakeFigures
from stcal.pipeline.fitting import Fitting, Kept
from stcal.pipeline.identifying import Identified
from stcal.pipeline.parameters import parameter_scale
from stcal.pipeline.pieces import Piece, step_for, thinned
from stcal.pipeline.sums import total
from stcal.residuals import Residual

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Solution:
    """What an estimator hands over.

    Attributes
    ----------
    identified : the final matches
    kept : the stars used
    camera : the fitted camera
    free : (K,) places of the estimated parameters, rising
    information : factor of the residuals at the fitted camera, in scaled estimated parameters
    residual : what was fitted
    covariance : (P, P) of the camera's parameters in their own units, zero for those held fixed
    noise_scale : sd of the residuals over the noise model
    """

    identified: Identified
    kept: Kept
    camera: Camera
    free: Ints
    information: SquareRootInformation
    residual: Residual
    covariance: Floats
    noise_scale: float

    @property
    def estimated_names(self) -> list[str]:
        """Names of the estimated parameters."""
        return [self.camera.parameter_names[k] for k in self.free]


@dataclass(frozen=True)
class Estimate:
    """A solution with what follows from it; ``baseline`` is what the initial calibration sees."""

    solution: Solution
    observed: Observability
    alignment: Alignment | None
    baseline: Identified
    figures: Figures

    @property
    def coverage(self) -> float:
        """Share of detector cells that hold a star."""
        return float(self.figures.occupied.mean())

    @property
    def rms_initial(self) -> float:
        """RMS arclength error [rad] of the fit's own arcs under the initial camera."""
        return float(self.figures.arcs.rms_rad[0])

    @property
    def rms_fitted(self) -> float:
        """The same under the fitted camera."""
        return float(self.figures.arcs.rms_rad[1])


def estimate_of(
    solution: Solution,
    fitting: Fitting,
    pieces: Sequence[Piece],
    initial: Calibration,
    baseline: tuple[str, Identified],
    matcher: Matcher,
    mapper: OrderedMap,
) -> Estimate:
    """Derive observability, alignment, coverage and RMS from a solution, in one more pass.

    ``fitting`` has kept the solution's stars; ``baseline`` is the cycle of the initial
    calibration's matches, which has kept their attitudes, and its numbers.
    """
    make = MakeFigures(
        fitting=fitting,
        initial=initial,
        camera=solution.camera,
        baseline=baseline[0],
        turn_step=step_for(pieces, MOST_TURNS),
        viewed=frozenset(piece.number for piece in thinned(pieces)),
    )
    figures = total(mapper(make, pieces))
    scale = parameter_scale(matcher.config, solution.estimated_names)
    return Estimate(
        solution=solution,
        observed=observability(solution.information, scale),
        alignment=update_alignment(initial.c_sd, figures.turns),
        baseline=baseline[1],
        figures=figures,
    )
