"""The sections of a scenario file, each valid by itself."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from stcal.config import STRICT, Finite, Magnitude

# Far beyond any sensible value, and so small that no square or product of them overflows.
Number = Annotated[float, Field(ge=-1e6, le=1e6)]
Positive = Annotated[float, Field(ge=1e-6, le=1e6)]
NotNegative = Annotated[float, Field(ge=0, le=1e6)]
HalfTurn = Annotated[float, Field(ge=0, le=180)]
Fraction = Annotated[float, Field(ge=0, le=1)]
# Strict sections take no list for a tuple, but TOML has nothing else.
Vector = Annotated[tuple[Number, Number, Number], Field(strict=False)]


def _whole_ms(value: float) -> float:
    if abs(value * 1e3 - round(value * 1e3)) > 1e-6:
        raise ValueError("not a whole number of milliseconds, which is what telemetry can write")
    return value


def _not_zero(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    if max(map(abs, vector)) < 1e-6:
        raise ValueError("is the zero vector")
    return vector


# A century fits; times beyond END_TAI_NS are refused for the scenario as a whole.
Seconds = Annotated[float, Field(ge=0, le=3.2e9), AfterValidator(_whole_ms)]
Period = Annotated[float, Field(gt=0, le=1e6), AfterValidator(_whole_ms)]
Direction = Annotated[Vector, AfterValidator(_not_zero)]


class Section(BaseModel):
    """One table of a scenario file: strict, and without unknown keys."""

    model_config = ConfigDict(**STRICT, arbitrary_types_allowed=True)


class OrbitSection(Section):
    """A circular orbit; the node by right ascension or by the mean local time of its ascent."""

    altitude_km: Annotated[float, Field(gt=100, lt=100_000)]
    inclination_deg: Annotated[float, Field(ge=0, le=180)]
    raan_deg: Number | None = None
    ltan_h: Annotated[float, Field(ge=0, lt=24)] | None = None
    # Argument of latitude at the scenario's epoch.
    phase_deg: Number = 0.0

    @model_validator(mode="after")
    def _one_node(self) -> OrbitSection:
        if (self.raan_deg is None) == (self.ltan_h is None):
            raise ValueError("give exactly one of raan_deg and ltan_h")
        return self


class Mounting(Section):
    """How the sensor sits in the spacecraft, and its detector in the sensor."""

    # Direction of S's z axis in B; at roll 0 S's x axis lies towards B's x (y when that is along z)
    boresight_b: Direction
    roll_deg: Number = 0.0
    # Rotation vectors of c_sd: as stored in the initial calibration, and the unknown change of it.
    c_sd_rotvec_deg: Vector = (0.0, 0.0, 0.0)
    c_sd_shift_urad: Vector = (0.0, 0.0, 0.0)
    # White noise per axis of the record of the body's attitude that comes with the telemetry.
    body_attitude_sd_urad: Annotated[Number, Field(ge=0.0, le=1e5)] = 30.0


class DriftStep(Section):
    """A lasting jump of the camera's parameters, from the first frame at or after ``at_s``."""

    at_s: Seconds
    offset_sigma: Annotated[dict[str, Number], Field(min_length=1)]


class Drift(Section):
    """How the true camera moves in time, in standard deviations of camera.scale.

    The departures add up: that of the temperature above telemetry.temperature_c, of ageing since
    the scenario's epoch, and of all steps that have happened.
    """

    per_kelvin: dict[str, Number] = {}
    per_day: dict[str, Number] = {}
    steps: Annotated[tuple[DriftStep, ...], Field(strict=False)] = ()


class CameraTruth(Section):
    """The initial calibration (nominal unless given) and the true camera's departure from it."""

    initial: dict[str, Finite] = {}
    # In standard deviations of the configuration's camera.scale (Enright 2018 Table III).
    offset_sigma: dict[str, Finite] = {}
    # Of the true camera; without it the camera stays as it is.
    drift: Drift = Drift()


class _Motion(Section):
    frames: Annotated[int, Field(ge=1, le=100_000_000)]
    # Slow wander about the motion: amplitude per axis, and the mean period of its waves.
    wander_deg: HalfTurn = 0.0
    wander_period_s: Positive = 600.0


class NadirPointing(_Motion):
    """B's z axis to nadir and x along the track, turned by an offset (x, then y, then z)."""

    motion: Literal["nadir-pointing"]
    offset_deg: Vector = (0.0, 0.0, 0.0)


class Slew(_Motion):
    """Constant rotation about an axis of B; continues the attitude before it unless aimed."""

    motion: Literal["slew"]
    rate_deg_s: Number
    axis_b: Direction
    # Right ascension, declination and position angle of S at the segment's start.
    target_deg: Vector | None = None


class CoarseHold(_Motion):
    """An inertial attitude held coarsely: the wander is what the coarse control leaves."""

    motion: Literal["coarse-hold"]
    target_deg: Vector | None = None


Segment = Annotated[NadirPointing | Slew | CoarseHold, Field(discriminator="motion")]


class Part(Section):
    """One telemetry set: consecutive segments sampled at a constant period."""

    # After the scenario's epoch.
    start_s: Seconds = 0.0
    sample_period_s: Period
    first_frame_id: Annotated[int, Field(ge=0, le=10**15)] = 1
    segments: Annotated[tuple[Segment, ...], Field(min_length=1, strict=False)]

    @property
    def frames(self) -> int:
        """Number of frames of all segments."""
        return sum(segment.frames for segment in self.segments)

    @property
    def last_s(self) -> float:
        """Time of the last frame after the scenario's epoch when none is edited out."""
        return self.start_s + (self.frames - 1) * self.sample_period_s

    @model_validator(mode="after")
    def _start(self) -> Part:
        first = self.segments[0]
        if not isinstance(first, NadirPointing) and first.target_deg is None:
            raise ValueError("the first segment has no attitude before it and needs target_deg")
        return self


class Detection(Section):
    """Which catalogue stars become detections, and what else does."""

    # Detection probability is 1/2 at the limit; logistic roll-off with this width in magnitudes.
    limiting_magnitude: Magnitude
    width_mag: Annotated[float, Field(ge=1e-6, le=10)]
    maximum_stars: Annotated[int, Field(ge=1, le=100_000)] = 32
    missing_probability: Fraction = 0.0
    false_stars_per_exposure: Annotated[float, Field(ge=0, le=1000)] = 0.0
    outlier_probability: Fraction = 0.0
    # Gross centroid errors: one sigma per axis.
    outlier_sd_px: NotNegative = 10.0
    # Depth of the catalogue from which the sky is made.
    sky_magnitude: Magnitude = 8.0


class TrueNoise(Section):
    """Centroid noise: sqrt(sd_px^2 + reference / intensity * photon_sd_px^2) per axis."""

    sd_px: NotNegative
    photon_sd_px: NotNegative = 0.0
    reference_intensity: Positive = 1000.0


class Intensity(Section):
    """Counts of a star: 10^(0.4 (zero_point_mag - V)), with log-normal scatter."""

    zero_point_mag: Annotated[float, Field(ge=-30, le=50)] = 14.0
    scatter_mag: Annotated[float, Field(ge=0, le=10)] = 0.1


class Visibility(Section):
    """When the view is bad: boresight nearer than these, the Earth's counted from its limb."""

    earth_exclusion_deg: HalfTurn = 15.0
    sun_exclusion_deg: HalfTurn = 45.0
    moon_exclusion_deg: HalfTurn = 15.0
    # Such frames, and those in eclipse, are edited out of the telemetry but for this share.
    keep_flagged: Fraction = 0.0
    # Stray light lifts the background: loss of limiting magnitude in intrusions.
    intrusion_loss_mag: Annotated[float, Field(ge=0, le=50)] = 2.0


class TelemetrySection(Section):
    """What the telemetry carries beside the stars."""

    exposure_separation_s: Annotated[float, Field(gt=0, le=3600)] = 0.1
    spacecraft_state: bool = True
    rate_sd_deg_s: NotNegative = 0.02
    # The true temperature is a sine about the reference at the orbit's nodal period, with this
    # amplitude; the sensor's reading adds noise.
    temperature_c: Number = 20.0
    temperature_swing_c: NotNegative = 4.0
    temperature_sd_c: NotNegative = 0.0
