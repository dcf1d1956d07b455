"""What the sensor makes of its detections: matches, quaternion and rate with its calibration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from stcal.attitude import frame_quaternions
from stcal.calibration import Calibration
from stcal.frames import FrameBatch
from stcal.matching import Matcher, match

Floats = NDArray[np.float64]

# Telemetry carries quaternions to 1e-9, which is 2 nrad.
_QUATERNION_DECIMALS = 9


def onboard(
    frames: FrameBatch,
    calibration: Calibration,
    matcher: Matcher,
    method: str = "lost-in-space",
) -> FrameBatch:
    """Return the frames with star_id, q_si and best_exposure as the sensor reports them.

    ``rate_deg_s`` stays where there is a fix and is NaN elsewhere.  The method is one of
    ``stcal.matching.METHODS``; the flight software is stateless (Enright 2018 section I-B).
    """
    matched = match(frames, calibration.camera, calibration.c_sd, matcher, method)
    q_si, best = frame_quaternions(matched, calibration.c_sd)
    codes = matcher.catalogue.star_id
    identified = (matched.star >= 0) & matched.solved[frames.exposure_of_star]
    star_id = np.where(identified, codes[np.maximum(matched.star, 0)], 0)
    rate = np.where((best >= 0)[:, None], frames.rate_deg_s, np.nan)
    return replace(
        frames,
        star_id=star_id,
        q_si=np.round(q_si, _QUATERNION_DECIMALS),
        best_exposure=best,
        rate_deg_s=rate,
    )
