"""When frames are taken, in which attitude, and what spoils the view at that time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stcal.constants import DEG, EARTH_RADIUS_M
from stcal.errors import ConfigError
from stcal.simulate.attitude import Motion, attitude_at, draw_wander, motion_of, mounting_rotation
from stcal.simulate.orbit import Orbit, in_shadow, state, sun_and_moon
from stcal.simulate.scenario import END_TAI_NS, Scenario
from stcal.simulate.sections import Part, Visibility

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_NS_PER_MS = 1_000_000
# A segment that has not found its frames in so many sample times won't find them.
_MOST_SAMPLES_PER_FRAME = 50
# Sample times whose view is looked at together.
_VIEW_SAMPLES = 1 << 16


def tai_ns(epoch_tai_ns: int, t_s: Floats) -> NDArray[np.int64]:
    """Return TAI ns of times since the epoch, on the whole milliseconds that telemetry writes."""
    return epoch_tai_ns + np.round(t_s * 1e3).astype(np.int64) * _NS_PER_MS


@dataclass(frozen=True)
class Timeline:
    """Frames of one part: (F,) columns, and the motions that ``motion`` indexes.

    ``first`` is the number of the first frame in its part, from 0.
    """

    motions: tuple[Motion, ...]
    motion: NDArray[np.int64]
    t_s: Floats
    eclipse: Bools
    intrusion: Bools
    first: int = 0

    @property
    def n_frames(self) -> int:
        """Number of frames F."""
        return len(self.t_s)

    def piece(self, start: int, stop: int) -> Timeline:
        """Return the frames of the part from ``start`` to before ``stop``."""
        rows = slice(start - self.first, stop - self.first)
        columns = (self.motion[rows], self.t_s[rows], self.eclipse[rows], self.intrusion[rows])
        return Timeline(self.motions, *columns, first=start)


def make_timeline(
    scenario: Scenario, part: Part, orbit: Orbit, rng: np.random.Generator
) -> Timeline:
    """Lay out the segments one after another, editing flagged frames out but for their share.

    Raises
    ------
    ConfigError
        When a segment sees nothing but the Earth, the Sun, the Moon or the shadow, or looks for
        frames beyond the year 2099.
    """
    c_bs = mounting_rotation(scenario.mounting)
    start, before = part.start_s, None
    motions, columns = [], []
    for index, segment in enumerate(part.segments):
        motion = motion_of(segment, start, before, c_bs, draw_wander(segment, rng))
        t_s, eclipse, intrusion = _frames(scenario, part, motion, orbit, c_bs, rng)
        if len(t_s) < segment.frames:
            raise ConfigError(
                f"{scenario.sensor_id}: segment {index} ({segment.motion}) finds {len(t_s)} of "
                f"{segment.frames} frames without eclipse or intrusion in "
                f"{_MOST_SAMPLES_PER_FRAME * segment.frames} sample times"
            )
        motions.append(motion)
        columns.append((np.full(len(t_s), index), t_s, eclipse, intrusion))
        start = float(t_s[-1]) + part.sample_period_s
        before = attitude_at(motion, orbit, np.array([start]))[0][0]
    number, t_s, eclipse, intrusion = map(np.concatenate, zip(*columns, strict=True))
    return Timeline(tuple(motions), number, t_s, eclipse, intrusion)


def attitudes(
    timeline: Timeline, orbit: Orbit, rows: slice, delay_s: float
) -> tuple[Floats, Floats]:
    """Return quaternions of c_ib (K, 4) and rates in B (K, 3) of frames ``rows``, delayed."""
    index, t_s = timeline.motion[rows], timeline.t_s[rows] + delay_s
    q_ib, rate = np.empty((len(t_s), 4)), np.empty((len(t_s), 3))
    for number in np.unique(index):
        where = index == number
        c_ib, rate[where] = attitude_at(timeline.motions[number], orbit, t_s[where])
        q_ib[where] = c_ib.as_quat()
    return q_ib, rate


def _frames(
    scenario: Scenario,
    part: Part,
    motion: Motion,
    orbit: Orbit,
    c_bs: Rotation,
    rng: np.random.Generator,
) -> tuple[Floats, Bools, Bools]:
    """Return times and flags of the segment's frames, fewer than wanted where there are none."""
    wanted = motion.segment.frames
    samples, most = wanted, _MOST_SAMPLES_PER_FRAME * wanted
    kept = eclipse = intrusion = np.zeros(0, dtype=np.bool_)
    while True:
        t_s: Floats = motion.start_s + part.sample_period_s * np.arange(samples, dtype=np.float64)
        if t_s[-1] >= (END_TAI_NS - scenario.epoch_tai_ns) * 1e-9:
            raise ConfigError(
                f"{scenario.sensor_id}: a {motion.segment.motion} segment finds too few frames "
                "without eclipse or intrusion before the year 2100"
            )
        for k in range(len(kept), samples, _VIEW_SAMPLES):
            more = view_flags(scenario, motion, orbit, c_bs, t_s[k : k + _VIEW_SAMPLES])
            lucky = rng.random(len(more[0])) < scenario.visibility.keep_flagged
            kept = np.concatenate([kept, ~(more[0] | more[1]) | lucky])
            eclipse, intrusion = np.concatenate([[eclipse, intrusion], more], axis=1)
        if kept.sum() >= wanted or samples == most:
            break
        samples = min(2 * samples, most)
    # The next segment's draws don't depend on how far this one had to look.
    rng.bit_generator.advance(most - samples)  # type: ignore[attr-defined]
    found = np.flatnonzero(kept)[:wanted]
    return t_s[found], eclipse[found], intrusion[found]


def view_flags(
    scenario: Scenario, motion: Motion, orbit: Orbit, c_bs: Rotation, t_s: Floats
) -> tuple[Bools, Bools]:
    """Return (T,) eclipse and (T,) intrusion of the Earth, the Sun or the Moon in the view."""
    c_ib, _ = attitude_at(motion, orbit, t_s)
    boresight = (c_ib * c_bs).apply([0.0, 0.0, 1.0])
    position, _ = state(orbit, t_s)
    sun, moon = sun_and_moon(tai_ns(scenario.epoch_tai_ns, t_s))
    limits: Visibility = scenario.visibility
    up = position / np.linalg.norm(position, axis=1)[:, None]
    limb = np.arcsin(EARTH_RADIUS_M / orbit.radius_m) + limits.earth_exclusion_deg * DEG
    intrusion = (
        (_angle(boresight, -up) < limb)
        | (_angle(boresight, sun) < limits.sun_exclusion_deg * DEG)
        | (_angle(boresight, moon) < limits.moon_exclusion_deg * DEG)
    )
    return in_shadow(position, sun), intrusion


def _angle(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.arccos(np.clip(np.einsum("ti,ti->t", a, b), -1.0, 1.0)))
