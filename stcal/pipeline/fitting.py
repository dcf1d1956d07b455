"""Passes that fit a camera to kept stars: outliers out, residuals linearised and reduced, summed.

Each pass returns mergeable sums (histogram counts, square-root information factors), so what is in
memory is one fragment a worker.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.config import SensorConfig
from stcal.estimators.batch import BatchSolution, levenberg_marquardt
from stcal.estimators.information import SquareRootInformation, merge
from stcal.execution import OrderedMap
from stcal.pipeline.identifying import get_stars
from stcal.pipeline.parameters import parameter_scale
from stcal.pipeline.pieces import Piece, thinned
from stcal.pipeline.scratch import Scratch
from stcal.pipeline.sums import Sums, total
from stcal.residuals import BoundResidual, Residual
from stcal.residuals.departures import count_departures, robust_scale
from stcal.residuals.selection import StarSelection, inliers, star_departures

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Outliers are judged anew after each fit; it settles in two or three rounds.
_REJECTION_ROUNDS = 5


@dataclass(frozen=True)
class Kept(Sums):
    """Stars that outlier rejection leaves, in numbers that add up.

    Attributes
    ----------
    stars, exposures : what is left
    rejected, changed : stars left out, and those that were not left out before or the reverse
    rows, dependent : independent residuals, and those that carry nothing new
    """

    stars: int
    exposures: int
    rejected: int
    changed: int
    rows: int
    dependent: int


@dataclass(frozen=True)
class Fitting:
    """How the stars of one cycle are fitted; its methods are passes over pieces.

    What a pass keeps stands under the round's own name and is never changed: a piece that is done
    again, since its worker died, finds what it found before.
    """

    scratch: Scratch
    cycle: str
    config: SensorConfig
    residual: Residual
    free: Ints
    round_: int = 0

    def departures(self, piece: Piece, camera: Camera) -> Ints:
        """Count the departures of all usable stars from their attitudes."""
        return count_departures(star_departures(self.usable_stars(piece), camera))

    def reject(
        self, piece: Piece, camera: Camera, scale: float, again: bool
    ) -> tuple[Kept, SquareRootInformation]:
        """Leave out outliers, keep the rest for :meth:`linearise`, and linearise at once.

        With ``again`` the rest is compared with that of the round before.
        """
        everything, rules = self.usable_stars(piece), self.config.fit
        left = inliers(
            everything, camera, rules.rejection_sigma, scale, rules.minimum_stars_per_exposure
        )
        changed = left
        if again:
            (before,) = self.scratch.get(_name(self.cycle, self.round_ - 1, "kept"), piece.number)
            changed = left != before
        self.scratch.put(self.name("kept"), piece.number, left)
        bound = self._bound(piece, camera, everything)
        counts = Kept(
            stars=len(bound.selection.star),
            exposures=bound.selection.n_exposures,
            rejected=int((~left).sum()),
            changed=int(changed.sum()),
            rows=bound.rows,
            dependent=bound.dependent,
        )
        return counts, reduced(bound, camera, self.free)

    def linearise(self, piece: Piece, bound_with: Camera, camera: Camera) -> SquareRootInformation:
        """Return the factor of [H | r] at a camera; the noise in rad is that of ``bound_with``."""
        return reduced(self._bound(piece, bound_with), camera, self.free)

    def _bound(
        self, piece: Piece, camera: Camera, usable: StarSelection | None = None
    ) -> BoundResidual:
        return self.scratch.cached(
            self.name("bound"),
            piece.number,
            lambda: self.residual.bind(self.kept_stars(piece, usable), camera),
        )

    def usable_stars(self, piece: Piece) -> StarSelection:
        """Return the cycle's stars, outliers and all."""
        return get_stars(self.scratch, f"{self.cycle} stars", piece.number)

    def kept_stars(self, piece: Piece, usable: StarSelection | None = None) -> StarSelection:
        """Return the stars that the round's rejection has left, of ``usable`` if it was read."""
        (left,) = self.scratch.get(self.name("kept"), piece.number)
        stars = self.usable_stars(piece) if usable is None else usable
        return stars.keep(left, 1)

    def name(self, what: str) -> str:
        """Return what a round's arrays are kept under."""
        return _name(self.cycle, self.round_, what)


def reduced(bound: BoundResidual, camera: Camera, free: Ints) -> SquareRootInformation:
    """Return the factor of [H | r] at a camera, for parameters ``free``."""
    return SquareRootInformation(bound.reduce(camera, free), bound.rows)


@dataclass(frozen=True)
class Fitted:
    """A camera fitted to the stars that the round of ``fitting`` has kept.

    ``sampled`` is the camera of the even sample, ``camera`` itself where there was no other fit.
    """

    fitting: Fitting
    camera: Camera
    kept: Kept
    solution: BatchSolution
    sampled: Camera

    @property
    def usable(self) -> bool:
        """Whether stars have been fitted, and gave a camera."""
        return self.kept.rows > 0 and bool(np.isfinite(self.camera.parameters).all())


def fit_camera(
    fitting: Fitting,
    pieces: Sequence[Piece],
    camera: Camera,
    departures: Ints,
    mapper: OrderedMap,
    roughly: bool = False,
) -> Fitted:
    """Fit a camera to the kept stars of a cycle, outliers left out until they settle.

    Of many pieces an even sample is fitted first; its camera and scale then judge the outliers of
    all of them, and are so near the solution that a step or two over everything find it.  With
    ``roughly`` the sample's camera will do, unless the sample gives none.

    ``departures`` are those of all pieces at the camera to start from.
    """
    few, scale = thinned(pieces), robust_scale(departures)
    fitted = None
    for round_ in range(_REJECTION_ROUNDS):
        now = replace(fitting, round_=round_)
        if fitted is not None:
            camera = fitted.camera
            scale = robust_scale(total(mapper(partial(now.departures, camera=camera), few)))
        kept, here = _rejected(now, few, camera, scale, mapper, again=fitted is not None)
        if fitted is not None and kept.changed == 0:
            fitting.scratch.drop(now.name("bound"))
            break
        fitted = _solved(now, few, camera, kept, here, mapper)
    assert fitted is not None
    if len(few) < len(pieces) and not (roughly and fitted.usable):
        camera, now = fitted.camera, replace(fitting, round_=_REJECTION_ROUNDS)
        kept, here = _rejected(now, pieces, camera, scale, mapper)
        fitted = replace(_solved(now, pieces, camera, kept, here, mapper), sampled=camera)
    return fitted


def _solved(
    fitting: Fitting,
    pieces: Sequence[Piece],
    camera: Camera,
    kept: Kept,
    here: SquareRootInformation,
    mapper: OrderedMap,
) -> Fitted:
    """Solve for a round's stars, from a camera at which the factor is known."""
    linearise = partial(fitting.linearise, bound_with=camera)
    start = camera.parameters[fitting.free]

    def factor(values: Floats) -> SquareRootInformation:
        if np.array_equal(values, start):
            return here
        there = with_estimated(camera, fitting.free, values)
        return merge(mapper(partial(linearise, camera=there), pieces))

    scales = parameter_scale(fitting.config, camera.parameter_names)[fitting.free]
    solution = levenberg_marquardt(factor, start, scales)
    fitting.scratch.drop(fitting.name("bound"))
    fitted = with_estimated(camera, fitting.free, solution.parameters)
    return Fitted(fitting, fitted, kept, solution, sampled=fitted)


def _rejected(
    fitting: Fitting,
    pieces: Sequence[Piece],
    camera: Camera,
    scale: float,
    mapper: OrderedMap,
    again: bool = False,
) -> tuple[Kept, SquareRootInformation]:
    reject = partial(fitting.reject, camera=camera, scale=scale, again=again)
    counts, factors = zip(*mapper(reject, pieces), strict=True)
    return total(counts), merge(factors)


def linearised_at(
    fitting: Fitting, pieces: Sequence[Piece], camera: Camera, departures: Ints, mapper: OrderedMap
) -> tuple[Kept, SquareRootInformation]:
    """Leave out outliers once, at a camera found otherwise, and return the factor there."""
    return _rejected(fitting, pieces, camera, robust_scale(departures), mapper)


def with_estimated(camera: Camera, free: Ints, values: Floats) -> Camera:
    """Return the camera with new values of the estimated parameters."""
    parameters = camera.parameters.copy()
    parameters[free] = values
    return camera.with_parameters(parameters)


def solve(
    bound: Sequence[BoundResidual], camera: Camera, scale: Floats, free: Ints, mapper: OrderedMap
) -> BatchSolution:
    """Run the batch estimator over whitened residuals, for parameters ``free``, without passes."""

    def factor(values: Floats) -> SquareRootInformation:
        there = with_estimated(camera, free, values)
        return merge(mapper(partial(reduced, camera=there, free=free), bound))

    return levenberg_marquardt(factor, camera.parameters[free], scale[free])


def forget(scratch: Scratch, cycle: str) -> None:
    """Forget what a cycle's rounds have kept."""
    for round_ in range(_REJECTION_ROUNDS + 1):
        scratch.drop(_name(cycle, round_, "kept"))


def _name(cycle: str, round_: int, what: str) -> str:
    return f"{cycle} round {round_} {what}"
