"""From a scenario to telemetry with its truth, in chunks that don't depend on each other."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stcal.calibration import Calibration
from stcal.constants import DEG, EXPOSURES_PER_FRAME
from stcal.frames import FrameBatch, concatenate
from stcal.simulate import detector
from stcal.simulate.attitude import mounting_rotation
from stcal.simulate.drift import parameters_at, warmth_at
from stcal.simulate.onboard import onboard
from stcal.simulate.orbit import state
from stcal.simulate.scenario import PARTS, Scenario
from stcal.simulate.sky import places, stars_in_cones
from stcal.simulate.timeline import attitudes, tai_ns
from stcal.simulate.true_camera import field_of_view
from stcal.simulate.world import CHUNK_FRAMES, World, calibrations, make_world

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_PER_STAR = ("star_id", "sd_px", "outlier")
_RATE_DECIMALS, _KM_DECIMALS, _KM_S_DECIMALS, _TEMPERATURE_DECIMALS = 5, 3, 6, 2

ChunkMap = Callable[[Callable[[int], "SimulatedPart"], Iterable[int]], Iterable["SimulatedPart"]]


@dataclass(frozen=True)
class Truth:
    """What the telemetry doesn't say, in the order of its frames, exposures and detections.

    Attributes
    ----------
    q_si : (E, 4) true attitude of S relative to I, scalar last
    rate_deg_s : (F, 3) true body rates in S at exposure 0
    pos_km, vel_km_s : (F, 3) true state of the spacecraft at exposure 0
    parameters : (F, P) of the true camera, the same in both exposures
    star_id : (S,) code of the star that made the detection, 0 for a false star
    sd_px : (S,) centroid noise per axis, NaN for a false star
    outlier : (S,) bool, gross centroid error
    """

    q_si: Floats
    rate_deg_s: Floats
    pos_km: Floats
    vel_km_s: Floats
    parameters: Floats
    star_id: Ints
    sd_px: Floats
    outlier: NDArray[np.bool_]


@dataclass(frozen=True)
class SimulatedPart:
    """One telemetry set (or a chunk of it) and its truth."""

    frames: FrameBatch
    truth: Truth

    def rows(self, start: int, stop: int) -> SimulatedPart:
        """Return the frames from ``start`` to before ``stop``."""
        first, last = EXPOSURES_PER_FRAME * start, EXPOSURES_PER_FRAME * stop
        stars = slice(self.frames.star_offsets[first], self.frames.star_offsets[last])
        columns = {
            f.name: getattr(self.truth, f.name)[
                stars if f.name in _PER_STAR else slice(start, stop)
            ]
            for f in fields(Truth)
        }
        columns["q_si"] = self.truth.q_si[first:last]
        return SimulatedPart(self.frames.take(np.arange(start, stop)), Truth(**columns))


@dataclass(frozen=True)
class Simulation:
    """A simulated sensor: both calibrations, and both telemetry sets.

    ``true`` has the camera without drift: at the scenario's epoch and telemetry.temperature_c.
    """

    scenario: Scenario
    seed: int
    initial: Calibration
    true: Calibration
    calibration: SimulatedPart
    validation: SimulatedPart


def simulate(scenario: Scenario, seed: int, map_chunks: ChunkMap = map) -> Simulation:
    """Return a simulated sensor; the same scenario and seed give the same bytes.

    ``map_chunks`` is an ordered map (``map``, or a pool's): the result doesn't depend on it.

    Raises
    ------
    ConfigError
        When a segment never sees the sky.
    InputError
        When the configuration's catalogue can't be read.
    """
    initial, true = calibrations(scenario)
    parts = {
        name: join(map_chunks(partial(simulate_chunk, world), range(world.n_chunks)))
        for name, world in ((name, make_world(scenario, name, seed)) for name in PARTS)
    }
    return Simulation(scenario, seed, initial, true, parts["calibration"], parts["validation"])


def stream(scenario: Scenario, part: str, seed: int) -> Iterator[SimulatedPart]:
    """Yield the chunks of one part, for runs that don't fit in memory."""
    world = make_world(scenario, part, seed)
    return (simulate_chunk(world, chunk) for chunk in range(world.n_chunks))


def simulate_chunk(world: World, chunk: int) -> SimulatedPart:
    """Return one chunk of a part: a pure function of the world and the chunk's number."""
    # Child 0 laid out the timeline; each chunk has its own.
    seed = np.random.SeedSequence(world.seed, spawn_key=(1, chunk))
    rng = np.random.default_rng(seed)
    start = chunk * CHUNK_FRAMES - world.timeline.first
    rows = slice(start, min(start + CHUNK_FRAMES, world.timeline.n_frames))
    q_si, rate = _sensor_attitudes(world, rows)
    t_s = world.timeline.t_s[rows]
    pos_km, vel_km_s = state(world.orbit, t_s)
    warmth = warmth_at(world.scenario.telemetry.temperature_swing_c, world.orbit, t_s)
    drift, sensor = world.scenario.camera.drift, world.scenario.sensor
    parameters = parameters_at(world.true.camera, drift, sensor, t_s, warmth)
    found = _detections(world, rows, q_si, parameters, rng)
    codes = world.sky.catalogue.star_id
    truth = Truth(
        q_si=q_si,
        rate_deg_s=rate,
        pos_km=pos_km,
        vel_km_s=vel_km_s,
        parameters=parameters,
        star_id=np.where(found.star >= 0, codes[np.maximum(found.star, 0)], 0),
        sd_px=found.sd_px,
        outlier=found.outlier,
    )
    frames = _telemetry(world, rows, truth, warmth, found, rng)
    return SimulatedPart(onboard(frames, world.initial, world.matcher), truth)


def _sensor_attitudes(world: World, rows: slice) -> tuple[Floats, Floats]:
    """Return true q_si (2 K, 4) of every exposure and rates [deg/s] in S (K, 3) at exposure 0."""
    c_bs = mounting_rotation(world.scenario.mounting)
    separation = world.scenario.telemetry.exposure_separation_s
    first, rate_b = attitudes(world.timeline, world.orbit, rows, 0.0)
    second, _ = attitudes(world.timeline, world.orbit, rows, separation)
    both = np.stack([first, second], axis=1).reshape(-1, 4)
    q_si = (Rotation.from_quat(both) * c_bs).as_quat(canonical=True)
    return q_si, np.asarray(c_bs.inv().apply(rate_b)) / DEG


def _detections(
    world: World, rows: slice, q_si: Floats, parameters: Floats, rng: np.random.Generator
) -> detector.Detections:
    """Return the detections of exposures: true attitudes q_si (E, 4), true cameras (F, P)."""
    scenario, camera = world.scenario, world.true.camera
    c_si = np.swapaxes(Rotation.from_quat(q_si).as_matrix(), 1, 2)
    c_di = world.true.c_sd.T @ c_si
    middle, radius = field_of_view(camera, parameters)
    exposure, star = stars_in_cones(world.sky, np.swapaxes(c_di, 1, 2) @ middle, radius)

    intruded = np.repeat(world.timeline.intrusion[rows], EXPOSURES_PER_FRAME)
    loss = np.where(intruded, scenario.visibility.intrusion_loss_mag, 0.0)
    limit = scenario.detection.limiting_magnitude - loss
    magnitude = world.sky.catalogue.magnitude[star]
    bright = detector.draw_detected(magnitude, limit[exposure], scenario.detection, rng)
    exposure, star, magnitude = exposure[bright], star[bright], magnitude[bright]

    separation = scenario.telemetry.exposure_separation_s
    t_s = world.timeline.t_s[rows, None] + separation * np.arange(EXPOSURES_PER_FRAME)
    t_s = t_s.ravel()
    t_tai_ns = tai_ns(scenario.epoch_tai_ns, t_s)
    s_i = places(world.sky, star, exposure, t_tai_ns, *state(world.orbit, t_s))
    drifting = camera.with_parameters(parameters[exposure // EXPOSURES_PER_FRAME].T)
    m, n, inside = detector.image(drifting, np.einsum("kij,kj->ki", c_di[exposure], s_i))
    seen = detector.Images(exposure[inside], star[inside], magnitude[inside], m[inside], n[inside])
    return detector.detect(seen, len(q_si), camera, scenario, rng)


def _telemetry(
    world: World,
    rows: slice,
    truth: Truth,
    warmth: Floats,
    found: detector.Detections,
    rng: np.random.Generator,
) -> FrameBatch:
    """Return the frames before the sensor identifies anything, rounded as telemetry is."""
    scenario, part = world.scenario, world.scenario.part(world.part)
    options = scenario.telemetry
    timeline = world.timeline
    t_s = timeline.t_s[rows]
    count = len(t_s)
    first = part.first_frame_id + timeline.first + rows.start
    rate = truth.rate_deg_s + options.rate_sd_deg_s * rng.normal(size=(count, 3))
    temperature = options.temperature_c + warmth
    temperature += options.temperature_sd_c * rng.normal(size=count)
    unknown = np.full((count, 3), np.nan)
    per_exposure = np.bincount(found.exposure, minlength=EXPOSURES_PER_FRAME * count)
    return FrameBatch(
        sensor_id=scenario.sensor_id,
        frame_id=np.arange(first, first + count, dtype=np.int64),
        t_tai_ns=tai_ns(scenario.epoch_tai_ns, t_s),
        best_exposure=np.full(count, -1, dtype=np.int8),
        q_si=np.full((count, 4), np.nan),
        rate_deg_s=np.round(rate, _RATE_DECIMALS),
        temperature_c=np.round(temperature, _TEMPERATURE_DECIMALS),
        eclipse=timeline.eclipse[rows],
        intrusion=timeline.intrusion[rows],
        pos_km=np.round(truth.pos_km, _KM_DECIMALS) if options.spacecraft_state else unknown,
        vel_km_s=np.round(truth.vel_km_s, _KM_S_DECIMALS) if options.spacecraft_state else unknown,
        star_offsets=np.concatenate(([0], np.cumsum(per_exposure))).astype(np.int64),
        row_px=found.row_px,
        col_px=found.col_px,
        intensity=found.intensity,
        star_id=np.zeros(len(found.star), dtype=np.int64),
    )


def join(chunks: Iterable[SimulatedPart]) -> SimulatedPart:
    """Return consecutive chunks as one part."""
    listed = list(chunks)
    truth = Truth(
        **{
            f.name: np.concatenate([getattr(chunk.truth, f.name) for chunk in listed])
            for f in fields(Truth)
        }
    )
    return SimulatedPart(concatenate([chunk.frames for chunk in listed]), truth)
