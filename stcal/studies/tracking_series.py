"""What the figures of the study ``tracking`` show of its first run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.constants import URAD
from stcal.frames import FrameBatch
from stcal.pipeline.numbers import numbers
from stcal.studies.tracking_cases import Followed
from stcal.studies.tracking_measures import Track

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SHOWN = ("f_m", "m0_px", "n0_px")
_SHOWN_FRAMES = 400
_BLOCK_FRAMES = 25
_NS_PER_HOUR = 3.6e12


def shown_frames(count: int) -> Ints:
    """Return places of at most _SHOWN_FRAMES of ``count`` frames, evenly spread."""
    places = np.linspace(0, count - 1, min(count, _SHOWN_FRAMES))
    return np.unique(np.round(places).astype(np.int64))


def series(followed: Followed, tracks: Mapping[str, Track], frames: Ints) -> dict[str, Any]:
    """Return truth and estimates of the parameters SHOWN at some frames.

    Each is the departure from the simulated camera at its reference, in the parameter's own unit.
    """
    simulation = followed.simulation
    camera, part = simulation.true.camera, simulation.calibration
    places = {name: camera.parameter_names.index(name) for name in SHOWN}
    return {
        "frame": (frames + 1).tolist(),
        "time_h": numbers(hours_of(part.frames)[frames]),
        "truth": {
            name: numbers(part.truth.parameters[frames, k] - camera.parameters[k])
            for name, k in places.items()
        },
        "variants": {
            variant: {
                name: {
                    "value": numbers(found.value[frames, k] - camera.parameters[k]),
                    "sd": numbers(found.sd[frames, k]),
                }
                for name, k in places.items()
            }
            for variant, found in tracks.items()
        },
    }


def hours_of(frames: FrameBatch) -> Floats:
    """Return hours since the first frame (F,)."""
    return np.asarray((frames.t_tai_ns - frames.t_tai_ns[0]) / _NS_PER_HOUR)


def block_errors(frames: FrameBatch, sums: Mapping[str, tuple[Floats, Ints]]) -> dict[str, Any]:
    """Return RMS arclength errors over blocks of frames, each frame with the estimate before it.

    ``sums`` are squares [rad^2] and numbers of pairs by frame, of each variant.
    """
    starts = np.arange(0, frames.n_frames, _BLOCK_FRAMES)
    hours = hours_of(frames)[np.minimum(starts + _BLOCK_FRAMES // 2, frames.n_frames - 1)]
    found: dict[str, Any] = {
        "frames": _BLOCK_FRAMES,
        "frame": (starts + 0.5 * (1 + _BLOCK_FRAMES)).tolist(),
        "time_h": numbers(hours),
    }
    for name, (squares, pairs) in sums.items():
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = np.add.reduceat(squares, starts) / np.add.reduceat(pairs, starts)
        found[name] = numbers(np.sqrt(mean) / URAD)
    return found
