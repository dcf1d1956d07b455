"""The fits of one sensor: batch, and the paper's three filters; Enright 2018 sections II and III-B.

The filters run without the watch that falls back to the baseline: the paper's have none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stcal.calibration import Calibration
from stcal.cameras import Camera
from stcal.frames import FrameBatch
from stcal.matching import Matcher
from stcal.pipeline.filter_run import Run
from stcal.pipeline.filtering import Variant, process_noise_of
from stcal.pipeline.fit import FitResult, fit_batch
from stcal.pipeline.sequential import SequentialResult, fit_sequential

# The parameters of the Samaan comparison.
REDUCED = ("f_m", "m0_px", "n0_px")


@dataclass(frozen=True)
class FilterKind:
    """One of the paper's filters: with process noise or not, rematching or not."""

    process_noise: bool
    rematch: bool


FILTERS = {
    "q": FilterKind(process_noise=True, rematch=True),
    "no_q": FilterKind(process_noise=False, rematch=True),
    "no_refit": FilterKind(process_noise=True, rematch=False),
}
METHODS = ("batch", *FILTERS)


@dataclass(frozen=True)
class Fits:
    """The fits of one sensor from one starting calibration and for one set of parameters."""

    initial: Calibration
    batch: FitResult | None
    filters: Mapping[str, SequentialResult]

    @property
    def documents(self) -> dict[str, dict[str, Any]]:
        """The fits' documents by method."""
        batch = {} if self.batch is None else {"batch": self.batch.document}
        return batch | {name: result.document for name, result in self.filters.items()}

    @property
    def cameras(self) -> dict[str, Camera]:
        """The fitted cameras by method, whether or not a gate let them pass."""
        return {
            name: _fitted_camera(self.initial.camera, document)
            for name, document in self.documents.items()
        }

    @property
    def runs(self) -> dict[str, Run]:
        """The filters' ways through the frames."""
        return {name: result.runs[result.chosen] for name, result in self.filters.items()}


def _fitted_camera(initial: Camera, document: dict[str, Any]) -> Camera:
    # A document writes a value that is no number as None: NaN here, which identifies no star.
    fitted = [item["fitted"] for item in document["parameters"]]
    return initial.with_parameters(np.array(fitted, dtype=np.float64))


def fit_all(
    frames: FrameBatch,
    initial: Calibration,
    matcher: Matcher,
    parameters: tuple[str, ...] | None = None,
) -> Fits:
    """Fit the camera by every method; ``parameters`` are those to estimate, None for all."""
    batch = fit_batch([frames], initial, matcher, {}, parameters=parameters)
    return replace(fit_filters(frames, initial, matcher, parameters), batch=batch)


def fit_filters(
    frames: FrameBatch,
    initial: Calibration,
    matcher: Matcher,
    parameters: tuple[str, ...] | None = None,
) -> Fits:
    """Fit the camera by the filters alone."""
    noise = process_noise_of(matcher.config, initial.camera.parameter_names)
    filters = {}
    for name, kind in FILTERS.items():
        variant = Variant(
            rematch=kind.rematch,
            process_noise=noise if kind.process_noise else {},
            parameters=parameters,
            shadow=False,
        )
        filters[name] = fit_sequential([frames], initial, matcher, {}, variant)
    return Fits(initial, None, filters)
