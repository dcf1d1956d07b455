"""What all chunks of one telemetry set share: cameras, orbit, timeline, sky and matcher."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from stcal.calibration import Calibration
from stcal.catalog.catalogue import select
from stcal.constants import DEG, URAD
from stcal.matching import Matcher
from stcal.simulate import detector
from stcal.simulate.orbit import Orbit, orbit_from
from stcal.simulate.scenario import PARTS, Scenario
from stcal.simulate.sky import Sky, full_catalogue, make_sky
from stcal.simulate.timeline import Timeline, make_timeline
from stcal.simulate.true_camera import cameras_of

CHUNK_FRAMES = 256


@dataclass(frozen=True)
class World:
    """All that the chunks of one part share; sent to workers as it is."""

    scenario: Scenario
    initial: Calibration
    true: Calibration
    orbit: Orbit
    timeline: Timeline
    sky: Sky
    matcher: Matcher
    part: str
    seed: tuple[int, ...]

    @property
    def n_chunks(self) -> int:
        """Number of chunks of CHUNK_FRAMES frames."""
        return -(-self.timeline.n_frames // CHUNK_FRAMES)


def calibrations(scenario: Scenario) -> tuple[Calibration, Calibration]:
    """Return the (initial, true) calibrations of a scenario.

    The true alignment is the stored one turned by ``c_sd_shift_urad``.
    """
    camera, mounting = scenario.camera, scenario.mounting
    initial, true = cameras_of(camera.initial, camera.offset_sigma, scenario.sensor)
    stored = Rotation.from_rotvec(np.array(mounting.c_sd_rotvec_deg) * DEG)
    shifted = Rotation.from_rotvec(np.array(mounting.c_sd_shift_urad) * URAD) * stored
    made = {"simulated": True, "scenario": scenario.sensor_id}
    return (
        Calibration(scenario.sensor_id, 1, initial, stored.as_matrix(), provenance=made),
        Calibration(
            scenario.sensor_id, 1, true, shifted.as_matrix(), provenance=made | {"truth": True}
        ),
    )


def entropy_of(scenario: Scenario, seed: int, number: int) -> tuple[int, int, int]:
    """Return what seeds one stream of a simulation: the parts come first, the rest after them.

    One seed for all sensors of a study still gives each sensor its own noise.
    """
    return seed, zlib.crc32(scenario.sensor_id.encode()), number


def make_world(scenario: Scenario, part: str, seed: int) -> World:
    """Return what the chunks of a part share: timeline, sky, matcher."""
    initial, true = calibrations(scenario)
    orbit = orbit_from(scenario.orbit, scenario.epoch_tai_ns)
    entropy = entropy_of(scenario, seed, PARTS.index(part))
    layout = np.random.default_rng(np.random.SeedSequence(entropy, spawn_key=(0,)))
    config = scenario.sensor
    depth = min(scenario.detection.sky_magnitude, detector.faintest(scenario.detection))
    known = select(
        full_catalogue(config.catalogue),
        config.catalogue.limiting_magnitude,
        config.catalogue.merge_separation_arcsec,
    )
    return World(
        scenario=scenario,
        initial=initial,
        true=true,
        orbit=orbit,
        timeline=make_timeline(scenario, scenario.part(part), orbit, layout),
        sky=make_sky(config.catalogue, depth),
        matcher=Matcher(known, config),
        part=part,
        seed=entropy,
    )
