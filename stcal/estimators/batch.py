"""Batch estimator: Levenberg-Marquardt in scaled parameters on merged square-root partials."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.estimators.information import SquareRootInformation, scaled

Floats = NDArray[np.float64]
Linearise = Callable[[Floats], SquareRootInformation]

_ITERATIONS = 60
_DAMPING_START = 1e-6
# Below this damping shortens no step worth mentioning: what a rejected step is tried again with.
_DAMPING_FELT = 1e-2
_DAMPING_LIMIT = 1e12
# What a step of this part of a parameter's sd changes doesn't matter to anyone.
_STEP_SD = 1e-3
# Above this the steps' lengths don't yet foretell the next one's.
_FORETELLING_SD = 0.1


@dataclass(frozen=True)
class BatchSolution:
    """Result of the batch estimator.

    Attributes
    ----------
    parameters : (P,)
    information : the factor at the solution, in scaled parameters (one unit = one Table II sigma);
        its matrix is that of the last linearisation, within a tenth of an sd
    chi2 : weighted sum of squares at the solution
    iterations : accepted steps
    converged : whether what is left is below a thousandth of every parameter's sd
    """

    parameters: Floats
    information: SquareRootInformation
    chi2: float
    iterations: int
    converged: bool


def levenberg_marquardt(linearise: Linearise, start: Floats, scale: Floats) -> BatchSolution:
    """Minimise the whitened sum of squares (Enright 2018 eq 14) from ``start`` (P,).

    ``linearise`` gives the merged factor of [H | r] at given parameters.  Steps are taken in
    x' = x / scale (eq 22), damped by a multiple of the diagonal of H'^T H' (Marquardt 1963).
    """
    x = np.array(start, dtype=np.float64)
    here = scaled(linearise(x), scale)
    damping, accepted, converged, before = _DAMPING_START, 0, False, 0.0
    for _ in range(_ITERATIONS):
        # LAPACK prints on standard output when it is handed NaN.
        if not (np.isfinite(here.root).all() and np.isfinite(here.projected).all()):
            break
        whole = _damped_step(here, 0.0)
        # The undamped length decides on convergence, or heavy damping would feign it.
        length = _in_sd(here, whole)
        if _last_step(length, before):
            # Such a step needs no look at where it leads, which would be one more pass.
            x, here, converged = x + whole * scale, _after(here, whole), True
            accepted += 1
            break
        step = _damped_step(here, damping)
        there = scaled(linearise(x + step * scale), scale)
        if np.isfinite(there.chi2) and there.chi2 <= here.chi2 * (1.0 + 1e-12):
            x, here, before = x + step * scale, there, length
            damping, accepted = max(damping / 10.0, 1e-12), accepted + 1
        else:
            damping = max(10.0 * damping, _DAMPING_FELT)
            if damping > _DAMPING_LIMIT:
                break
    return BatchSolution(x, here, here.chi2, accepted, converged)


def _last_step(length: float, before: float) -> bool:
    """Return whether nothing that matters is left after a step, the accepted one being ``before``.

    Steps shrink by a ratio that itself falls, so the next is at most length (length / before).
    """
    if length < _STEP_SD:
        return True
    return length < _FORETELLING_SD and length * length < _STEP_SD * before


def _damped_step(information: SquareRootInformation, damping: float) -> Floats:
    root = information.root
    diagonal = np.sqrt(damping) * np.sqrt((root**2).sum(axis=0))
    stacked = np.vstack([root, np.diag(diagonal)])
    target = np.concatenate([-information.projected, np.zeros(len(diagonal))])
    step: Floats = np.linalg.lstsq(stacked, target, rcond=None)[0]
    return step


def _after(information: SquareRootInformation, step: Floats) -> SquareRootInformation:
    """Return the factor after a step, as the linear problem has it."""
    factor = information.factor.copy()
    factor[:-1, -1] += information.root @ step
    return SquareRootInformation(factor, information.rows)


def _in_sd(information: SquareRootInformation, step: Floats) -> float:
    """Length of a step in the metric of the information: at most the largest |step / sd|.."""
    return float(np.linalg.norm(information.root @ step))


def covariance_from(information: SquareRootInformation) -> Floats:
    """Return (H^T H)^-1 (P, P) of the factor's parameters.

    Raises
    ------
    numpy.linalg.LinAlgError
        When the factor is singular: a parameter is not observable at all.
    """
    root = information.root
    inverse = np.linalg.solve(root, np.eye(len(root)))
    return np.asarray(inverse @ inverse.T)


@dataclass(frozen=True)
class Observability:
    """Singular value analysis of the scaled Jacobian, Enright 2018 eqs (23)-(24).

    Attributes
    ----------
    singular_values : (P,) falling
    singular_vectors : (P, P) right singular vectors as columns, in scaled parameters
    condition_raw, condition_scaled : condition numbers of H before and after scaling
    """

    singular_values: Floats
    singular_vectors: Floats
    condition_raw: float
    condition_scaled: float


def observability(information: SquareRootInformation, scale: Floats) -> Observability:
    """Analyse the factor of scaled parameters; ``scale`` (P,) gives back the raw Jacobian."""
    _, values, vectors = np.linalg.svd(information.root)
    # Orient each vector by its largest element, so that reports compare.
    largest = np.abs(vectors).argmax(axis=1)
    vectors = vectors * np.sign(vectors[np.arange(len(values)), largest])[:, None]
    raw = np.linalg.svd(information.root / scale, compute_uv=False)
    return Observability(values, vectors.T, _condition(raw), _condition(values))


def _condition(values: NDArray[np.floating]) -> float:
    return float(values[0] / values[-1]) if values[-1] > 0 else float("inf")
