"""Gates of a fit: why a result must not be trusted, each reason with its figures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stcal.calibration import Calibration
from stcal.config import Fit, SensorConfig
from stcal.constants import URAD
from stcal.frames import FrameBatch
from stcal.pipeline.estimate import Estimate

# A matched set that still moves the parameters by more than this is no fit.
_UNSETTLED_SD = 1.0
_RMS_MARGIN = 1.01


def fit_refusals(
    estimate: Estimate, batches: Sequence[FrameBatch], initial: Calibration, config: SensorConfig
) -> list[str]:
    """Return the reasons to refuse, empty when the fit may be trusted."""
    gates = config.fit
    reasons = _too_little(estimate, gates)
    if reasons:
        return reasons
    return [
        *_not_converged(estimate),
        *_degenerate(estimate, gates),
        *_implausible(estimate, initial, config),
    ]


def _too_little(estimate: Estimate, gates: Fit) -> list[str]:
    last = estimate.last
    frames = sum(int(m.frame_solved.sum()) for m in last.matched)
    stars = sum(len(b.selection.star) for b in last.bound)
    reasons = []
    if frames < gates.minimum_frames:
        reasons.append(f"{frames} frames identified, at least {gates.minimum_frames} needed")
    if stars < gates.minimum_stars:
        reasons.append(f"{stars} stars usable, at least {gates.minimum_stars} needed")
    if estimate.coverage < gates.minimum_coverage:
        reasons.append(
            f"stars cover {estimate.coverage:.0%} of the detector, at least "
            f"{gates.minimum_coverage:.0%} needed"
        )
    if last.solution.information.rows <= len(last.camera.parameters):
        reasons.append(
            f"{last.solution.information.rows} independent arclengths for "
            f"{len(last.camera.parameters)} parameters"
        )
    return reasons


def _not_converged(estimate: Estimate) -> list[str]:
    last = estimate.last
    reasons = []
    if not last.solution.converged:
        reasons.append(
            f"the estimator did not converge in {last.solution.iterations} accepted steps"
        )
    if not estimate.settled and estimate.change_in_last_cycle_sd > _UNSETTLED_SD:
        reasons.append(
            f"the matched set did not settle in {len(estimate.cycles)} cycles: the last one "
            f"changed {last.changed} matches and moved a parameter by "
            f"{estimate.change_in_last_cycle_sd:.1f} sd"
        )
    return reasons


def _degenerate(estimate: Estimate, gates: Fit) -> list[str]:
    condition = estimate.observed.condition_scaled
    reasons = []
    if not condition <= gates.maximum_condition:
        reasons.append(
            f"degenerate: condition number {condition:.3g} after scaling, at most "
            f"{gates.maximum_condition:.3g} allowed"
        )
    if not np.isfinite(estimate.covariance).all():
        reasons.append("degenerate: a parameter is not observable at all")
    return reasons


def _implausible(estimate: Estimate, initial: Calibration, config: SensorConfig) -> list[str]:
    gates, camera = config.fit, estimate.last.camera
    reasons = []
    for name, new, old in zip(
        camera.parameter_names, camera.parameters, initial.camera.parameters, strict=True
    ):
        moved = abs(new - old) / config.camera.scale[name].sigma
        if not moved <= gates.maximum_change_sigma:
            reasons.append(
                f"{name} moved by {moved:.1f} sigma, at most {gates.maximum_change_sigma:g} allowed"
            )
    if not estimate.last.noise_scale <= gates.maximum_noise_scale:
        reasons.append(
            f"residuals are {estimate.last.noise_scale:.1f} times the noise model, at most "
            f"{gates.maximum_noise_scale:g} allowed"
        )
    # The fit minimises the weighted sum of squares: the plain RMS may rise a little.
    if not estimate.rms_fitted <= _RMS_MARGIN * estimate.rms_initial:
        reasons.append(
            f"RMS rose from {estimate.rms_initial / URAD:.1f} to {estimate.rms_fitted / URAD:.1f}"
            " urad"
        )
    limit = gates.maximum_rms_urad
    if limit is not None and not estimate.rms_fitted <= limit * URAD:
        reasons.append(f"RMS is {estimate.rms_fitted / URAD:.1f} urad, at most {limit:g} allowed")
    if estimate.alignment is None:
        reasons.append("no exposure is solved under both calibrations, so C_SD can't be kept")
    return reasons
