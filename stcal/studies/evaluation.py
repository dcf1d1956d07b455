"""Several cameras on one telemetry set, on the same star pairs: Enright 2018 II-B and III."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.cameras import Camera
from stcal.constants import URAD
from stcal.frames import FrameBatch, MatchedFrames
from stcal.matching import Matcher, match
from stcal.pipeline.numbers import number
from stcal.residuals import choose_arcs, select_stars
from stcal.residuals.arclength import Arcs

Floats = NDArray[np.float64]

# The simulation's own camera is a yardstick: a sensor in orbit has no pairs identified with it.
TRUE = "true"


def evaluate(
    frames: FrameBatch, cameras: Mapping[str, Camera], c_sd: Floats, matcher: Matcher
) -> dict[str, Any]:
    """Rematch the frames that count with each camera, and compare all on common pairs.

    Parameters
    ----------
    frames : the telemetry; frames in eclipse and intrusion are left out
    cameras : cameras by name, the first one being what the others are compared to
    c_sd : (3, 3) the alignment
    matcher : catalogue and sensor configuration

    Returns
    -------
    ``frames`` counted; ``pairs`` common pairs, the largest set that any camera identifies (section
    II-B), and ``pairs_from`` its name; by camera ``availability``, ``matched_stars``,
    ``matched_star_ratio`` against the first camera (eq 30), ``rms_urad`` over the common pairs, and
    ``own_rms_urad`` over the pairs that the camera itself identifies.
    """
    counted = frames.take(frames.counts_for_availability)
    matched = {name: match(counted, c, c_sd, matcher) for name, c in cameras.items()}
    arcs = {name: pairs_of(m, matcher) for name, m in matched.items()}
    chosen = max((name for name in arcs if name != TRUE), key=lambda name: len(arcs[name]))
    first = next(iter(matched.values())).is_matched.sum()
    return {
        "frames": counted.n_frames,
        "pairs": len(arcs[chosen]),
        "pairs_from": chosen,
        "cameras": {
            name: {
                "availability": number(float(m.frame_solved.mean())),
                "matched_stars": int(m.is_matched.sum()),
                "matched_star_ratio": number(float(m.is_matched.sum() / first)) if first else None,
                "rms_urad": number(rms_urad(arcs[chosen].departures(cameras[name]))),
                "own_rms_urad": number(rms_urad(arcs[name].departures(cameras[name]))),
            }
            for name, m in matched.items()
        },
    }


def pairs_of(matched: MatchedFrames, matcher: Matcher) -> Arcs:
    """Return the star pairs of every solved exposure by the 2 N - 3 rule."""
    noise, minimum = matcher.config.noise, matcher.config.fit.minimum_stars_per_exposure
    return choose_arcs(select_stars(matched, noise, minimum))


def rms_urad(departures: Floats) -> float:
    """Return the root mean square of arclength errors (A,), eq (20); NaN without any."""
    return float(np.sqrt(np.mean(departures**2)) / URAD) if len(departures) else float("nan")
