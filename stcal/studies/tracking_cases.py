"""The filters of the study ``tracking``: which cases, which variants, and one run of each.

The process noise was chosen by experiment.  On the drift, a walk of 1 sigma per square root of an
hour gives the focal length its smallest rms error and the band its right width (rms of error / sd
0.95 over four seeds, against 2.8 at a third and 0.87 at three times the walk).  Over the minute
that such a filter remembers, the walk expects 0.13 sigma, and the focal length moves by 0.10 (rms).
The same walk brings the estimate back soonest after the step without much more noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from stcal.matching import Matcher
from stcal.pipeline.filtering import Variant
from stcal.pipeline.sequential import SequentialResult, fit_sequential
from stcal.simulate import Scenario, Simulation, scenario_with, simulate
from stcal.studies.scenarios import matcher_of, shortened

# Random walk of what moves, in sigma per square root of an hour; and factors that show its effect.
WALK = 1.0
FACTORS = {"q_third": 1.0 / 3.0, "q": 1.0, "q_triple": 3.0}


@dataclass(frozen=True)
class Case:
    """A simulated sensor whose camera changes, or might.

    Attributes
    ----------
    scenario : name of the scenario file
    moving : the parameters that change
    steps : they change at once, in one step
    walks : run the filters with and without process noise
    thermal : parameters that may be linear in temperature in a run of its own; none for no such run
    """

    scenario: str
    moving: tuple[str, ...]
    steps: bool = False
    walks: bool = True
    thermal: tuple[str, ...] = ()


CASES = {
    "drift": Case("st16-drift", ("f_m",), thermal=("f_m",)),
    "step": Case("st16-step", ("f_m", "m0_px"), steps=True),
    "constant": Case("st16-1", (), walks=False, thermal=("f_m",)),
}


@dataclass(frozen=True)
class Followed:
    """One simulated sensor and what each variant of the filter made of it."""

    simulation: Simulation
    matcher: Matcher
    results: Mapping[str, SequentialResult]


def variants_of(case: Case, names: tuple[str, ...]) -> dict[str, Variant]:
    """Return the variants of a case by name; ``names`` are the camera's parameters.

    ``no_q`` has no process noise; ``q_third``, ``q`` and ``q_triple`` that of the moving parameters
    times 1/3, 1 and 3; ``q_all`` that of every parameter, as if nobody knew which one moves;
    ``thermal`` decides by evidence on parameters linear in temperature.
    """
    noises: dict[str, dict[str, float]] = {}
    if case.walks:
        noises = {"no_q": {}}
        noises |= {
            key: dict.fromkeys(case.moving, factor * WALK) for key, factor in FACTORS.items()
        }
        noises["q_all"] = dict.fromkeys(names, WALK)
    found = {key: Variant(process_noise=noise) for key, noise in noises.items()}
    if case.thermal:
        found["thermal"] = Variant(process_noise={}, temperature=case.thermal)
    return found


def follow(case: Case, scenario: Scenario, seed: int) -> Followed:
    """Simulate a case and run all its variants."""
    simulation, matcher = simulate(scenario, seed), matcher_of(scenario.sensor)
    initial, frames = simulation.initial, [simulation.calibration.frames]
    return Followed(
        simulation,
        matcher,
        {
            name: fit_sequential(frames, initial, matcher, {}, variant)
            for name, variant in variants_of(case, initial.camera.parameter_names).items()
        },
    )


def short_scenario(case: Case, scenario: Scenario, frames: int | None) -> Scenario:
    """Return the scenario with so many calibration frames, a step still in their middle."""
    found, steps = shortened(scenario, frames), scenario.camera.drift.steps
    if frames is None or not steps:
        return found
    part = scenario.calibration
    share = frames / part.frames
    start_s = float(round(steps[0].at_s - share * (steps[0].at_s - part.start_s)))
    return scenario_with(found, calibration__start_s=start_s)
