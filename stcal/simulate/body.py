"""The spacecraft's own attitude, as a record of it comes with the telemetry."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stcal.constants import EXPOSURES_PER_FRAME, URAD
from stcal.simulate.attitude import mounting_rotation
from stcal.simulate.scenario import PARTS, Scenario
from stcal.simulate.simulation import Simulation
from stcal.simulate.world import entropy_of

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def body_attitudes(simulation: Simulation) -> tuple[Ints, Floats]:
    """Return what the spacecraft knows of its attitude: times (F,) and noisy q_bi (F, 4).

    At exposure 0 of the frames of both parts, in the order of time.
    """
    scenario = simulation.scenario
    parts = [getattr(simulation, name) for name in PARTS]
    times = np.concatenate([part.frames.t_tai_ns for part in parts])
    q_si = np.concatenate([part.truth.q_si[::EXPOSURES_PER_FRAME] for part in parts])
    rng = np.random.default_rng(entropy_of(scenario, simulation.seed, len(PARTS)))
    q_bi = noisy_body_attitudes(scenario, q_si, rng)
    order = np.argsort(times, kind="stable")
    return times[order], q_bi[order]


def noisy_body_attitudes(scenario: Scenario, q_si: Floats, rng: np.random.Generator) -> Floats:
    """Return q_bi (F, 4) as the spacecraft knows it where the sensor truly is at q_si (F, 4)."""
    mounting = scenario.mounting
    noise = rng.normal(0.0, mounting.body_attitude_sd_urad * URAD, (len(q_si), 3))
    c_bs = mounting_rotation(mounting)
    c_ib = Rotation.from_quat(q_si) * c_bs.inv() * Rotation.from_rotvec(noise)
    return np.asarray(c_ib.as_quat(canonical=True))
