"""Spacecraft motion: nadir pointing, slew and coarse hold, each with a slow wander.

A rotation ``c_ib`` takes components in B to I (``c_ib.apply(v_b) == v_i``); rates are those of B
relative to I, in components of B.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stcal.constants import DEG
from stcal.simulate.orbit import Orbit, local_frame
from stcal.simulate.sections import CoarseHold, Mounting, NadirPointing, Segment, Slew

Floats = NDArray[np.float64]

# Axes of B in L for a spacecraft that points to nadir: z down, x along the track, y right of it.
_C_LB_NADIR = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_WAVES = 3


@dataclass(frozen=True)
class Wander:
    """A small rotation c_{B'B}: waves (K, 3) of amplitude [rad], frequency [rad/s], phase."""

    amplitude: Floats
    frequency: Floats
    phase: Floats


@dataclass(frozen=True)
class Motion:
    """One segment's motion from ``start_s`` on; ``base`` is c_ib there (inertial motions)."""

    segment: Segment
    start_s: float
    base: Rotation
    wander: Wander


def draw_wander(segment: Segment, rng: np.random.Generator) -> Wander:
    """Draw waves whose sum has ``wander_deg`` as its RMS about each axis."""
    size = (_WAVES, 3)
    amplitude = segment.wander_deg * DEG * np.sqrt(2.0 / _WAVES) * np.ones(size)
    period = segment.wander_period_s * rng.uniform(0.6, 1.6, size)
    return Wander(amplitude, 2.0 * np.pi / period, rng.uniform(0.0, 2.0 * np.pi, size))


def mounting_rotation(mounting: Mounting) -> Rotation:
    """Return c_bs, S to B, from the boresight in B and the roll about it."""
    z = np.array(mounting.boresight_b) / np.linalg.norm(mounting.boresight_b)
    reference = np.eye(3)[0] if abs(z[0]) < 0.9 else np.eye(3)[1]
    x = reference - z * (reference @ z)
    x /= np.linalg.norm(x)
    c_bs = Rotation.from_matrix(np.stack([x, np.cross(z, x), z], axis=1))
    return c_bs * Rotation.from_rotvec([0.0, 0.0, mounting.roll_deg * DEG])


def target_rotation(target_deg: tuple[float, float, float]) -> Rotation:
    """Return c_is of a target: S's z at (right ascension, declination), x at a position angle.

    The position angle of x counts from north through east.
    """
    ra, dec, angle = np.array(target_deg) * DEG
    z = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    east = np.array([-np.sin(ra), np.cos(ra), 0.0])
    north = np.cross(z, east)
    x = np.cos(angle) * north + np.sin(angle) * east
    return Rotation.from_matrix(np.stack([x, np.cross(z, x), z], axis=1))


def motion_of(
    segment: Segment, start_s: float, before: Rotation | None, c_bs: Rotation, wander: Wander
) -> Motion:
    """Return the segment's motion; without a target it goes on from the attitude ``before``."""
    base = before if before is not None else Rotation.identity()
    target = None if isinstance(segment, NadirPointing) else segment.target_deg
    if target is not None:
        base = target_rotation(target) * c_bs.inv()
    elif not isinstance(segment, NadirPointing):
        # The wander starts somewhere: take it out so that the attitude is continuous.
        base = base * _wander_at(wander, np.zeros(1))[0][0].inv()
    return Motion(segment, start_s, base, wander)


def attitude_at(motion: Motion, orbit: Orbit, t_s: Floats) -> tuple[Rotation, Floats]:
    """Return c_ib (T) and the rates (T, 3) [rad/s] in B at times since the epoch."""
    base, base_rate = _BASES[motion.segment.motion](motion, orbit, t_s)
    wander, wander_rate = _wander_at(motion.wander, t_s - motion.start_s)
    # B' is the frame without wander: c_ib = c_ib' c_b'b, and rates add in B.
    return base * wander, wander.inv().apply(base_rate) + wander_rate


def _nadir(motion: Motion, orbit: Orbit, t_s: Floats) -> tuple[Rotation, Floats]:
    assert isinstance(motion.segment, NadirPointing)
    c_il, rate_i = local_frame(orbit, t_s)
    offset = Rotation.from_euler("XYZ", np.array(motion.segment.offset_deg) * DEG)
    c_ib = c_il * Rotation.from_matrix(_C_LB_NADIR) * offset
    return c_ib, np.asarray(c_ib.inv().apply(rate_i))


def _slew(motion: Motion, orbit: Orbit, t_s: Floats) -> tuple[Rotation, Floats]:
    assert isinstance(motion.segment, Slew)
    axis = np.array(motion.segment.axis_b) / np.linalg.norm(motion.segment.axis_b)
    rate = motion.segment.rate_deg_s * DEG * axis
    turned = Rotation.from_rotvec((t_s - motion.start_s)[:, None] * rate)
    return motion.base * turned, np.tile(rate, (len(t_s), 1))


def _hold(motion: Motion, orbit: Orbit, t_s: Floats) -> tuple[Rotation, Floats]:
    assert isinstance(motion.segment, CoarseHold)
    still = Rotation.from_rotvec(np.zeros((len(t_s), 3)))
    return motion.base * still, np.zeros((len(t_s), 3))


_BASES: dict[str, Callable[[Motion, Orbit, Floats], tuple[Rotation, Floats]]] = {
    "nadir-pointing": _nadir,
    "slew": _slew,
    "coarse-hold": _hold,
}


def _wander_at(wander: Wander, t_s: Floats) -> tuple[Rotation, Floats]:
    """Return the small rotations (T) and their rates (T, 3) in the turned frame.

    omega = J_r(v) dv/dt with the right Jacobian of SO(3) (Chirikjian 2012, eq 10.86).
    """
    argument = wander.frequency * t_s[:, None, None] + wander.phase
    vector = np.einsum("ki,tki->ti", wander.amplitude, np.sin(argument))
    slope = np.einsum("ki,tki->ti", wander.amplitude * wander.frequency, np.cos(argument))
    angle = np.linalg.norm(vector, axis=1)[:, None]
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    second = np.where(small, 1.0 / 6.0, (safe - np.sin(safe)) / safe**3)
    once = np.cross(vector, slope)
    rate = slope - first * once + second * np.cross(vector, once)
    return Rotation.from_rotvec(vector), rate
