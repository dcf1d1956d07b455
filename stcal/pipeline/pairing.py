"""The stars of a sensor beside the body's attitude at their time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stcal.attitude import attitude_covariance, solve_wahba
from stcal.calibration import Calibration
from stcal.constants import EXPOSURES_PER_FRAME
from stcal.estimators.misalignment import Sightings
from stcal.execution import OrderedMap, serial
from stcal.frames import FrameBatch, MatchedFrames
from stcal.matching import Matcher, match
from stcal.pipeline.body_attitude import BodyAttitudes, attitudes_at
from stcal.pipeline.fit import check_calibration
from stcal.residuals.departures import without_outliers
from stcal.residuals.selection import StarSelection, select_stars

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class FirstExposures:
    """The identified stars of every exposure 0, to which the frame's time belongs.

    How much later exposure 1 is, telemetry doesn't say, and the body turns meanwhile.

    Attributes
    ----------
    s_s, s_i : (K, 3) unit star vectors, measured and by catalogue
    sd : (K,) rad, noise of s_s per axis of the tangent plane
    frame : (K,) which usable frame, 0..F-1, rising
    t_tai_ns : (F,) time of the usable frames
    rejected : stars left out as outliers of their exposure
    """

    s_s: Floats
    s_i: Floats
    sd: Floats
    frame: Ints
    t_tai_ns: Ints
    rejected: int


def first_exposures(
    batches: Sequence[FrameBatch],
    calibration: Calibration,
    matcher: Matcher,
    matching: str = "lost-in-space",
    mapper: OrderedMap = serial,
) -> FirstExposures:
    """Identify the stars of a calibrated sensor, and leave outliers out."""
    batches = [batch for batch in batches if batch.n_frames]
    check_calibration(calibration, matcher.config, batches[0].sensor_id)
    camera, c_sd = calibration.camera, calibration.c_sd
    task = partial(match, camera=camera, c_sd=c_sd, matcher=matcher, method=matching)
    matched = list(mapper(task, batches))
    everything = [_of_first_exposures(m, matcher) for m in matched]
    rules = matcher.config.fit
    kept = without_outliers(
        everything, camera, rules.rejection_sigma, rules.minimum_stars_per_exposure
    )
    row, col, sd_px, s_i = (
        np.concatenate([getattr(s, name) for s in kept])
        for name in ("row_px", "col_px", "sd_px", "s_i")
    )
    counts = np.cumsum([0, *(s.n_exposures for s in kept)])
    return FirstExposures(
        s_s=camera.directions(row, col) @ c_sd.T,
        s_i=s_i,
        sd=sd_px * camera.noise_scale(row, col),
        frame=np.concatenate([s.exposure + n for s, n in zip(kept, counts, strict=False)]),
        t_tai_ns=np.concatenate([_times(m, s) for m, s in zip(matched, kept, strict=True)]),
        rejected=sum(len(s.star) for s in everything) - len(row),
    )


def _of_first_exposures(matched: MatchedFrames, matcher: Matcher) -> StarSelection:
    minimum = matcher.config.fit.minimum_stars_per_exposure
    selection = select_stars(matched, matcher.config.noise, minimum)
    exposure = matched.frames.exposure_of_star[selection.star]
    return selection.keep(exposure % EXPOSURES_PER_FRAME == 0, minimum)


def _times(matched: MatchedFrames, selection: StarSelection) -> Ints:
    """Return the times (X,) of the frames of usable exposures."""
    exposure = matched.frames.exposure_of_star[selection.star[selection.offsets[:-1]]]
    return matched.frames.t_tai_ns[exposure // EXPOSURES_PER_FRAME]


@dataclass(frozen=True)
class Paired:
    """Sightings of the frames that have a body attitude.

    Attributes
    ----------
    t_tai_ns : (F,) time of each frame
    usable_frames : frames with enough stars, with a body attitude or without
    stars_rejected : stars left out as outliers of their own exposure
    """

    sightings: Sightings
    t_tai_ns: Ints
    usable_frames: int
    stars_rejected: int


def pair(
    stars: FirstExposures, body: BodyAttitudes, maximum_gap_s: float, attitude_sd_rad: float
) -> Paired:
    """Bring the catalogue's star vectors into B; frames without a body attitude are left out.

    ``attitude_sd_rad`` is noise of the body's attitude beside what its source states.
    """
    c_bi, covariance = attitudes_at(body, stars.t_tai_ns, maximum_gap_s)
    everything = Sightings(
        s_s=stars.s_s,
        s_b=np.einsum("kij,kj->ki", c_bi[stars.frame], stars.s_i),
        sd=stars.sd,
        frame=stars.frame,
        attitude_covariance=covariance + np.eye(3) * attitude_sd_rad**2,
    )
    covered = np.asarray(np.isfinite(covariance).all(axis=(1, 2)))
    return Paired(everything.take(covered), stars.t_tai_ns[covered], len(covered), stars.rejected)


def solved_attitudes(stars: FirstExposures, source: dict[str, Any]) -> BodyAttitudes:
    """Return the attitudes of a calibrated sensor; its S frame is B."""
    count = len(stars.t_tai_ns)
    c_bi = solve_wahba(stars.s_s, stars.s_i, stars.sd**-2.0, stars.frame, count)
    covariance = attitude_covariance(stars.s_s, stars.sd, stars.frame, count)
    known = np.isfinite(covariance).all(axis=(1, 2))
    c_ib = np.swapaxes(c_bi[known], 1, 2)
    q_bi = Rotation.from_matrix(c_ib).as_quat() if known.any() else np.empty((0, 4))
    return BodyAttitudes(stars.t_tai_ns[known], q_bi, covariance[known], source)
