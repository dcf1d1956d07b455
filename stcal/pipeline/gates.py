"""Gates of a fit: why a result must not be trusted, each reason with its figures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from stcal.calibration import Calibration
from stcal.config import Fit, SensorConfig
from stcal.constants import URAD
from stcal.pipeline.cycles import Cycle, change_in_sd
from stcal.pipeline.estimate import Estimate

if TYPE_CHECKING:
    from stcal.pipeline.filter_run import Run

# A matched set that still moves the parameters by more than this is no fit.
_UNSETTLED_SD = 1.0
_RMS_MARGIN = 1.01
# A filter that has not halved a parameter's sd has seen nothing of it.
_LEARNED = 0.5


def batch_refusals(
    estimate: Estimate,
    cycles: Sequence[Cycle],
    settled: bool,
    initial: Calibration,
    config: SensorConfig,
) -> list[str]:
    """Return the reasons to refuse a batch fit, empty when it may be trusted."""
    unsettled = _not_converged(estimate, cycles, settled)
    return refusals(estimate, unsettled, initial, config)


def sequential_refusals(
    estimate: Estimate, run: Run, initial: Calibration, config: SensorConfig
) -> list[str]:
    """Return the reasons to refuse a sequential fit, empty when it may be trusted."""
    own = [*_watched(run, config), *_unconverged(run), *_too_weak(estimate, config)]
    return refusals(estimate, own, initial, config)


def _too_weak(estimate: Estimate, config: SensorConfig) -> list[str]:
    """Return that a direction is too weak for a filter, though a batch fit may still find it."""
    found, most = estimate.observed.condition_scaled, config.sequential.maximum_condition
    if found <= most or not found <= config.fit.maximum_condition:
        return []
    return [
        f"condition number {found:.3g} after scaling, at most {most:.3g} allowed for a filter: "
        "fit in a batch, or fewer --parameters"
    ]


def _watched(run: Run, config: SensorConfig) -> list[str]:
    """Return what the watch over the filter has to say."""
    from stcal.pipeline.filter_run import EVENTS

    history, most = run.history, config.sequential.maximum_fallbacks
    events = np.flatnonzero(history.event)
    reasons = []
    if len(events) > most:
        named = ", ".join(
            f"{EVENTS[history.event[f]]} at frame {history.frame_id[f]}" for f in events[:5]
        )
        reasons.append(
            f"the estimate fell back to the baseline {len(events)} times, at most {most} allowed: "
            f"{named}{', ...' if len(events) > 5 else ''}"
        )
    if history.on_baseline[-1]:
        reasons.append(
            "the estimate fell back to the baseline and had not proven itself again by the end"
        )
    return reasons


def _unconverged(run: Run) -> list[str]:
    """Return the parameters about which the filter has learned next to nothing."""
    start = np.sqrt(np.diag(run.filter.covariance(run.filter.start)))
    now = np.sqrt(np.diag(run.filter.covariance(run.state)))
    weak = [
        f"{run.filter.names[k]} ({now[k]:.1f} of {start[k]:.1f} sigma)"
        for k in run.filter.constants
        if not now[k] < _LEARNED * start[k]
    ]
    return [f"not converged: the sd is still near its start for {', '.join(weak)}"] if weak else []


def refusals(
    estimate: Estimate, unsettled: list[str], initial: Calibration, config: SensorConfig
) -> list[str]:
    """Return the reasons to refuse an estimate; ``unsettled`` are those of its estimator."""
    reasons = _too_little(estimate, config.fit)
    if reasons:
        return reasons
    return [
        *unsettled,
        *_degenerate(estimate, config.fit),
        *_implausible(estimate, initial, config),
    ]


def _too_little(estimate: Estimate, gates: Fit) -> list[str]:
    solution = estimate.solution
    frames, stars = solution.identified.frames_solved, solution.kept.stars
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
    if solution.information.rows <= len(solution.free):
        reasons.append(
            f"{solution.information.rows} independent arclengths for "
            f"{len(solution.free)} parameters"
        )
    return reasons


def _not_converged(estimate: Estimate, cycles: Sequence[Cycle], settled: bool) -> list[str]:
    last = cycles[-1]
    reasons = []
    if not last.fitted.solution.converged:
        reasons.append(
            f"the estimator did not converge in {last.fitted.solution.iterations} accepted steps"
        )
    moved = change_in_sd(cycles, -1, estimate.solution.covariance)
    if not settled and moved > _UNSETTLED_SD:
        reasons.append(
            f"the matched set did not settle in {len(cycles)} cycles: the last one "
            f"changed {last.identified.changed} matches and moved a parameter by {moved:.1f} sd"
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
    if not np.isfinite(estimate.solution.covariance).all():
        reasons.append("degenerate: a parameter is not observable at all")
    return reasons


def _implausible(estimate: Estimate, initial: Calibration, config: SensorConfig) -> list[str]:
    gates, camera = config.fit, estimate.solution.camera
    reasons = []
    for name, new, old in zip(
        camera.parameter_names, camera.parameters, initial.camera.parameters, strict=True
    ):
        moved = abs(new - old) / config.camera.scale[name].sigma
        if not moved <= gates.maximum_change_sigma:
            reasons.append(
                f"{name} moved by {moved:.1f} sigma, at most {gates.maximum_change_sigma:g} allowed"
            )
    if not estimate.solution.noise_scale <= gates.maximum_noise_scale:
        reasons.append(
            f"residuals are {estimate.solution.noise_scale:.1f} times the noise model, at most "
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
