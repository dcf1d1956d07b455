"""Simulated star trackers in orbit: scenario in, telemetry with its truth out."""

from stcal.simulate.scenario import PARTS, Scenario
from stcal.simulate.scenario_file import load_scenario, scenario_with, with_frames
from stcal.simulate.simulation import (
    SimulatedPart,
    Simulation,
    Truth,
    simulate,
    stream,
)
from stcal.simulate.world import calibrations

__all__ = [
    "PARTS",
    "Scenario",
    "SimulatedPart",
    "Simulation",
    "Truth",
    "calibrations",
    "load_scenario",
    "scenario_with",
    "simulate",
    "stream",
    "with_frames",
]
