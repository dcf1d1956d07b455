"""Stage ``align``: how the sensor sits in the spacecraft's body, Zhang et al. 2024, second stage.

It follows any fit: the stars of a calibrated sensor against the body's attitude from elsewhere.
(The C_SD update, which keeps a recalibrated sensor's own frame, is in ``alignment``.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stcal.calibration import Calibration
from stcal.config import Fit
from stcal.constants import URAD
from stcal.execution import OrderedMap, serial
from stcal.frames import FrameBatch
from stcal.matching import Matcher
from stcal.pipeline.align_estimate import AlignEstimate, estimate_alignment
from stcal.pipeline.body_attitude import BodyAttitudes
from stcal.pipeline.describe_align import alignment_document, attitude_excess_rad
from stcal.pipeline.pairing import Paired, first_exposures, pair

# Gates.  The paper's filter needs 200 s; a slow error of the body's attitude is the same in all
# frames of less.
_MINIMUM_SPAN_S = 200.0
_MINIMUM_COVERED = 0.5
_MAXIMUM_REJECTED = 0.2


@dataclass(frozen=True)
class AlignOptions:
    """How to align.

    Attributes
    ----------
    method : the name in MISALIGNMENT whose estimate is the result; the others are for comparison
    matching : how the stars are identified
    attitude_sd_urad : noise of the body's attitude per axis, beside what its source states
    maximum_gap_s : longest time between two attitudes to interpolate over
    """

    method: str = "multiplicative"
    matching: str = "lost-in-space"
    attitude_sd_urad: float = 0.0
    maximum_gap_s: float = 10.0


def align(
    batches: Sequence[FrameBatch],
    calibration: Calibration,
    body: BodyAttitudes,
    matcher: Matcher,
    provenance: dict[str, Any],
    options: AlignOptions,
    mapper: OrderedMap = serial,
) -> dict[str, Any]:
    """Return the document ``stcal.alignment/1``; one that a gate refused has no result.

    Parameters
    ----------
    batches : the sensor's frames, fragment by fragment in time order
    calibration : the sensor's, as ``fit`` writes it
    body : the body's attitude over time
    matcher : catalogue and sensor configuration
    provenance : hashes, stored in the document
    options : how to align
    """
    stars = first_exposures(batches, calibration, matcher, options.matching, mapper)
    paired = pair(stars, body, options.maximum_gap_s, options.attitude_sd_urad * URAD)
    gates = matcher.config.fit
    reasons, estimate = too_little(paired, gates.minimum_frames), None
    if paired.sightings.n_frames >= max(gates.minimum_frames, 2):
        estimate = estimate_alignment(paired.sightings, gates.rejection_sigma)
        reasons += _disagreeing(estimate, gates)
    used = {"maximum_gap_s": options.maximum_gap_s, "attitude_sd_urad": options.attitude_sd_urad}
    return alignment_document(
        paired, estimate, options.method, reasons, batches, calibration, body.source | used,
        provenance,
    )  # fmt: skip


def too_little(paired: Paired, minimum_frames: int) -> list[str]:
    """Return what the frames lack in number, in coverage by body attitudes, and in time."""
    covered, usable = len(paired.t_tai_ns), paired.usable_frames
    reasons = []
    if covered < minimum_frames:
        reasons.append(
            f"{covered} frames identified with a body attitude at their time, at least "
            f"{minimum_frames} needed"
        )
    if covered < _MINIMUM_COVERED * usable:
        reasons.append(
            f"the body's attitude is known at the time of {covered} of {usable} identified "
            f"frames, {_MINIMUM_COVERED:.0%} needed"
        )
    span_s = float(np.ptp(paired.t_tai_ns)) * 1e-9 if covered else 0.0
    if covered >= minimum_frames and span_s < _MINIMUM_SPAN_S:
        reasons.append(f"the frames span {span_s:.0f} s, at least {_MINIMUM_SPAN_S:.0f} s needed")
    return reasons


def _disagreeing(estimate: AlignEstimate, gates: Fit) -> list[str]:
    """Return how the frames contradict one alignment, or the noise."""
    reasons, most = [], gates.maximum_noise_scale
    rejected = 1.0 - float(estimate.kept.mean())
    if rejected > _MAXIMUM_REJECTED:
        reasons.append(
            f"{rejected:.0%} of the frames contradict the others, at most "
            f"{_MAXIMUM_REJECTED:.0%} allowed"
        )
    if not estimate.star_scale <= most:
        reasons.append(
            f"the stars scatter {estimate.star_scale:.1f} times their noise within their own "
            f"frames, at most {most:g} allowed: the calibration is not good"
        )
    if not estimate.scale.max() <= most:
        figures = ", ".join(f"{v:.1f}" for v in estimate.scale)
        excess = attitude_excess_rad(estimate) / URAD
        reasons.append(
            f"the frames scatter {figures} times their noise about x, y, z of S, at most {most:g} "
            "allowed: the calibration is not good, or the body's attitude has a noise of "
            f"{excess:.0f} urad beside the stated"
        )
    return reasons
