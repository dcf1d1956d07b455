"""A sequential filter set up from a sensor's configuration and a calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.calibration import Calibration
from stcal.config import SensorConfig
from stcal.estimators.sequential import SEQUENTIAL, SequentialEstimator, Steps
from stcal.matching import METHODS, Matcher
from stcal.pipeline import layout_kernels as layout
from stcal.pipeline import watch_kernels
from stcal.pipeline.filter_state import FilterState
from stcal.pipeline.parameters import estimated_indices, parameter_scale
from stcal.residuals import ARCLENGTH, Residual

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Coarser than the batch's, since it is made anew whenever the camera has moved far.
_SLOPE_NODES = 17


@dataclass(frozen=True)
class Variant:
    """Which filter runs, and how.

    Attributes
    ----------
    method, precision : an estimator of ``SEQUENTIAL`` and the precision of its arithmetic
    matches : a matching method, or ``telemetry`` for the on-board matches (without rematching)
    rematch : identify each frame with the current estimate; else only with the baseline
    process_noise : random walk by parameter, sigma per square root of an hour; empty for none
    parameters : the parameters to estimate, None for all
    temperature : those that may be linear in temperature
    shadow : fall back to the baseline when the estimate does worse
    residual : what the camera is fitted to
    """

    method: str = "sqrf"
    precision: str = "double"
    matches: str = "lost-in-space"
    rematch: bool = True
    process_noise: dict[str, float] | None = None
    parameters: tuple[str, ...] | None = None
    temperature: tuple[str, ...] = ()
    shadow: bool = True
    residual: Residual = ARCLENGTH


@dataclass(frozen=True)
class Filter:
    """A filter ready to run: its compiled steps, its model and rules, and where it starts.

    ``names`` (n,) are the camera parameters that the states belong to.
    """

    estimator: SequentialEstimator
    steps: Steps
    residual: Residual
    matcher: Matcher
    model: layout.Model
    rules: layout.Rules
    start: FilterState
    names: tuple[str, ...]
    reference_temperature_c: float
    kept_frames: int
    c_sd: Floats

    @property
    def n_states(self) -> int:
        """Number of states n."""
        return len(self.model.target)

    @property
    def constants(self) -> Ints:
        """Places of the states that are camera parameters at the reference temperature."""
        return np.flatnonzero(~self.model.thermal)

    def parameters(self, x: Floats) -> Floats:
        """Return camera parameters (..., P) at the reference temperature of states (..., n)."""
        out = np.broadcast_to(self.model.reference, (*x.shape[:-1], len(self.model.reference)))
        out = out.copy()
        where = self.constants
        out[..., self.model.target[where]] += x[..., where] * self.model.scale[where]
        return out

    def covariance(self, state: FilterState) -> Floats:
        """Return the covariance (n, n) of the state, scaled by the noise that it has seen."""
        out = np.empty((self.n_states, self.n_states))
        self.estimator.covariance(state.root, out)
        return out * float(watch_kernels.noise_scale(state.tally)) ** 2


def process_noise_of(config: SensorConfig, names: Sequence[str]) -> dict[str, float]:
    """Return the configured random walk (sigma per square root of an hour) of each parameter."""
    section = config.sequential
    return {name: section.process_noise.get(name, section.process_noise_sigma) for name in names}


def make_filter(
    variant: Variant, initial: Calibration, matcher: Matcher, thermal: bool = False
) -> Filter:
    """Set up a filter that starts from a calibration; ``thermal`` adds the temperature slopes."""
    config, camera = matcher.config, initial.camera
    estimator, names = SEQUENTIAL[variant.method], camera.parameter_names
    free = estimated_indices(variant.parameters, names)
    slopes = estimated_indices(variant.temperature, names) if thermal else np.empty(0, np.int64)
    target = np.concatenate([free, slopes])
    scale = parameter_scale(config, names)[target]
    noise = np.array([(variant.process_noise or {}).get(names[k], 0.0) for k in free])
    model = layout.Model(
        reference=camera.parameters,
        pixel_size_m=camera.pixel_size_m,
        rows=float(camera.rows),
        cols=float(camera.cols),
        target=target,
        scale=scale,
        thermal=np.arange(len(target)) >= len(free),
        noise_sd=np.concatenate([noise, np.zeros(len(slopes))]),
        slope_table=camera.noise_slope_table(_SLOPE_NODES),
        linearise_at=np.zeros(len(target)),
        options=variant.residual.options,
    )
    sd = np.where(
        model.thermal, config.sequential.temperature_sd_sigma, config.sequential.initial_sd_sigma
    )
    return Filter(
        estimator=estimator,
        steps=estimator.steps[variant.precision],
        residual=variant.residual,
        matcher=matcher,
        model=model,
        rules=_rules(variant, estimator, config),
        start=_start(estimator.root(sd), config),
        names=tuple(names[k] for k in target),
        reference_temperature_c=config.sequential.reference_temperature_c,
        kept_frames=config.sequential.relinearised_frames,
        c_sd=initial.c_sd,
    )


def _rules(variant: Variant, estimator: SequentialEstimator, config: SensorConfig) -> layout.Rules:
    watch = config.sequential
    return layout.Rules(
        rematch=variant.rematch,
        guided=variant.matches != "telemetry" and METHODS[variant.matches].guided,
        unscented=estimator.unscented,
        fixed=False,
        shadow=variant.shadow,
        minimum_stars=config.fit.minimum_stars_per_exposure,
        rejection_sigma=config.fit.rejection_sigma,
        lost_frames=watch.lost_frames,
        lost_star_share=watch.lost_star_share,
        divergence=watch.divergence,
        divergence_noise=config.fit.maximum_noise_scale**2,
    )


def _start(root: Floats, config: SensorConfig) -> FilterState:
    tally = np.empty(watch_kernels.TALLY)
    watch_kernels.clear_tally(tally)
    window = np.zeros((config.sequential.window_frames, watch_kernels.WINDOW))
    x, root = np.zeros(len(root)), np.ascontiguousarray(root)
    return FilterState(
        x, root, x, root, x, x, tally, window, np.empty((0, 0, 6)), np.empty((0, 2, 3, 3)),
        np.empty((0, 4)), np.empty((0, len(x) + 1, len(x))),
    )  # fmt: skip
