"""How the first stage converges: Figures 7 to 9, Table 3 and Figure 11 of Zhang et al. 2024.

The paper averages the curves of 100 runs and then takes their error.  That is not the error which
one sensor has: it is smaller by the root of the number of runs.  Both are told here, beside the
Cramer-Rao bound of one run.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.pipeline.numbers import number, numbers
from stcal.studies.bound import bound_over_images, image_information
from stcal.studies.given import KnownImages
from stcal.studies.zhang_paper import CALIBRATION_S, NAMES
from stcal.studies.zhang_runs import Tracks
from stcal.studies.zhang_scene import Scene

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_SHOWN_IMAGES, _FIRST_IMAGES = 80, 20
# A curve has converged when it stays within this share of the initial error.
_CONVERGED = 0.1


def shown_images(count: int) -> Ints:
    """Return places of images, 0 to ``count`` - 1, thinned for plotting; the first change most."""
    even = np.round(np.linspace(0, count - 1, min(count, _SHOWN_IMAGES))).astype(np.int64)
    return np.unique(np.concatenate([np.arange(min(count, _FIRST_IMAGES)), even]))


def image_at(t_s: Floats, time_s: float) -> int:
    """Return the place of the last image at or before a time; the last one if that is later."""
    return int(np.searchsorted(t_s, time_s, side="right")) - 1


def bounds(scene: Scene, images: KnownImages, noise_px: float) -> Floats:
    """Return the Cramer-Rao bound (F, P, P) after each image, with the filters' prior."""
    information = image_information(images, scene.true, noise_px, scene.scale)
    prior = np.diag((scene.scale / scene.prior_sd) ** 2)
    return bound_over_images(information, prior) * np.outer(scene.scale, scene.scale)


def sd_of(covariance: Floats) -> Floats:
    """Return sd (..., P) of covariances (..., P, P)."""
    return np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))


def convergence(
    scene: Scene, t_s: Floats, tracks: Mapping[str, Tracks], bound: Floats
) -> dict[str, Any]:
    """Return Figures 7 and 8: each filter's errors over time, and when they have converged."""
    shown = shown_images(len(t_s))
    initial = scene.initial.camera.parameters - scene.true.parameters
    return {
        "t_s": numbers(t_s[shown]),
        "bound": _by_name(sd_of(bound[shown])),
        "filters": {
            name: {
                **{key: _by_name(values[shown]) for key, values in _curves(track).items()},
                "converged": _converged(t_s, track, initial),
                "time_average": _values(scene.true.parameters + track.error.mean(axis=(0, 1))),
            }
            for name, track in tracks.items()
        },
    }


def _curves(track: Tracks) -> dict[str, Floats]:
    """Return (F, P): error of the averaged curve, mean absolute and RMS error, filter's own sd."""
    return {
        "averaged": track.error.mean(axis=0),
        "absolute": np.abs(track.error).mean(axis=0),
        "rms": np.sqrt((track.error**2).mean(axis=0)),
        "sd": np.sqrt((track.sd**2).mean(axis=0)),
    }


def _converged(t_s: Floats, track: Tracks, initial: Floats) -> dict[str, Any]:
    """Return when the averaged curve, and the mean absolute error, have converged [s]."""
    curves = _curves(track)
    return {
        key: {
            name: number(settled_s(t_s, curves[key][:, k], _CONVERGED * abs(initial[k])))
            for k, name in enumerate(NAMES)
        }
        for key in ("averaged", "absolute")
    }


def settled_s(t_s: Floats, curve: Floats, limit: float) -> float:
    """Return from when on a curve (F,) stays within a limit; NaN if it does not."""
    outside = np.flatnonzero(~(np.abs(curve) <= limit))
    first = int(outside[-1]) + 1 if len(outside) else 0
    return float(t_s[first]) if first < len(t_s) else float("nan")


def errors_at(t_s: Floats, tracks: Mapping[str, Tracks], bound: Floats) -> dict[str, Any]:
    """Return Table 3: the errors after 300 s.

    ``consistency`` is the RMS of error over the filter's own sd, ``over_bound`` the RMS error over
    the bound: 1 expected of an efficient filter.
    """
    at = image_at(t_s, CALIBRATION_S)
    least = sd_of(bound[at])
    found = {}
    for name, track in tracks.items():
        curves = _curves(track)
        standardised = track.error[:, at] / track.sd[:, at]
        found[name] = {
            **{key: _values(values[at]) for key, values in curves.items()},
            "consistency": _values(np.sqrt((standardised**2).mean(axis=0))),
            "over_bound": _values(curves["rms"][at] / least),
        }
    return {"t_s": float(t_s[at]), "bound": _values(least), "filters": found}


def _by_name(values: Floats) -> dict[str, list[Any]]:
    """Return columns (T, P) by parameter."""
    return {name: numbers(values[:, k]) for k, name in enumerate(NAMES)}


def _values(values: Floats) -> dict[str, float | None]:
    """Return (P,) values by parameter."""
    return {name: number(values[k]) for k, name in enumerate(NAMES)}
