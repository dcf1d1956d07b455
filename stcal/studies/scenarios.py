"""What every study makes of its scenario files."""

from __future__ import annotations

from stcal.catalog.catalogue import select
from stcal.config import SensorConfig
from stcal.matching import Matcher
from stcal.simulate import PARTS, Scenario, scenario_with
from stcal.simulate.sky import full_catalogue

# A shortened validation part still has the frames that a comparison needs.
_LEAST_FRAMES = 20


def shortened(scenario: Scenario, frames: int | None) -> Scenario:
    """Return the scenario with ``frames`` calibration frames and half as many for validation.

    Segments keep their shares; None leaves the scenario as it is.
    """
    if frames is None:
        return scenario
    wanted = dict(zip(PARTS, (frames, max(frames // 2, _LEAST_FRAMES)), strict=True))
    changes = {
        f"{name}__segments__{k}__frames": max(1, round(wanted[name] * share))
        for name in PARTS
        for k, share in enumerate(_shares(scenario, name))
    }
    return scenario_with(scenario, **changes)


def _shares(scenario: Scenario, name: str) -> list[float]:
    part = scenario.part(name)
    return [segment.frames / part.frames for segment in part.segments]


def matcher_of(config: SensorConfig) -> Matcher:
    """Return the matcher with the part of the catalogue that the configuration selects."""
    section = config.catalogue
    full = full_catalogue(section)
    chosen = select(full, section.limiting_magnitude, section.merge_separation_arcsec)
    return Matcher(chosen, config)
