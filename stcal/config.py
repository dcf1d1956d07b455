"""The sensor configuration: one TOML file describes a sensor type, validated in one go."""

from __future__ import annotations

import hashlib
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from stcal.cameras import CAMERAS
from stcal.errors import ConfigError
from stcal.reading import read_toml

SCHEMA = "stcal.sensor/1"

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Magnitude = Annotated[float, Field(ge=-2, le=30)]
Tolerance = Annotated[float, Field(gt=0, le=1e5)]


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError("holds characters that cannot be printed")
    return text


def _no_nul(text: str) -> str:
    if "\0" in text:
        raise ValueError("holds a NUL character, which no path may")
    return text


# Of every table of every TOML file.  Strict: a number written as text is a mistake; integers still
# pass for floats.
STRICT = ConfigDict(extra="forbid", frozen=True, strict=True)


class _Section(BaseModel):
    model_config = STRICT


class Detector(_Section):
    """The detector: rows m, columns n, square pixels."""

    rows: Annotated[int, Field(ge=2, le=100_000)]
    cols: Annotated[int, Field(ge=2, le=100_000)]
    pixel_size_m: Positive
    # Coordinate that the telemetry gives to the centre of the first pixel (both axes).
    first_pixel_centre_px: Finite = 0.0


class Scale(_Section):
    """Mean and standard deviation of one parameter from unit to unit (Enright Table II)."""

    nominal: Finite
    sigma: Positive


class CameraSection(_Section):
    """The camera model and the scale of each of its parameters."""

    model: str
    scale: dict[str, Scale]

    @model_validator(mode="after")
    def _names(self) -> CameraSection:
        problems = _name_problems(self.model, self.scale)
        if problems:
            raise ValueError("; ".join(problems))
        return self


def _name_problems(model: object, scale: object) -> list[str]:
    """Return what is wrong with the names of a camera section, whatever else is."""
    if not isinstance(model, str) or not isinstance(scale, dict):
        return []
    if model not in CAMERAS:
        return [f"model {model!r} is not known; known: {', '.join(CAMERAS)}"]
    names = CAMERAS[model].parameter_names
    problems = [f"scale.{p} is missing" for p in names if p not in scale]
    return problems + [f"scale.{p} is not a parameter" for p in scale if p not in names]


class Noise(_Section):
    """Centroid noise, one sigma per axis.

    ``constant``: sd_px for every star.  ``intensity``: sqrt(sd_px^2 + reference / intensity *
    photon_sd_px^2), photon noise growing for faint stars over a floor of sd_px.
    """

    model: Literal["constant", "intensity"] = "constant"
    sd_px: Positive
    photon_sd_px: NotNegative = 0.0
    reference_intensity: Positive = 1000.0


class CatalogueSection(_Section):
    """Which catalogue stars the sensor can see and tell apart."""

    # None: the bundled catalogue; else a file of `stcal catalog build`, relative to this file.
    path: Annotated[str, Field(min_length=1), AfterValidator(_no_nul)] | None = None
    limiting_magnitude: Magnitude
    # Stars closer than this are one photocentre to the detector.
    merge_separation_arcsec: Annotated[float, Field(ge=0, le=3600)]


class Matching(_Section):
    """Identification: tolerances and the acceptance rule shared by both methods."""

    # Largest arclength error of a pair that may seed a lost-in-space hypothesis.
    pair_tolerance_urad: Tolerance
    # Largest departure of a matched star from its catalogue place after the attitude solution.
    star_tolerance_urad: Tolerance
    minimum_matches: Annotated[int, Field(ge=3)] = 4
    # Longest pair used for seeding, shorter ones bear less distortion.
    pair_limit_deg: Annotated[float, Field(gt=0, le=90)] = 12.0
    # Brightest detections that seed hypotheses.
    seed_stars: Annotated[int, Field(ge=3, le=64)] = 12
    # Faintest catalogue stars in the pair table; None: all. Deep catalogues need a limit here.
    seed_magnitude: Magnitude | None = None
    # Accepted expectation of false alarms in an exposure without a true solution; the bound
    # is approximate, the measured rate lies within a factor of five of it.
    false_alarm: Annotated[float, Field(gt=0, lt=0.1)] = 1e-4
    # Radius in which `guided` looks around its attitude hint.
    hint_radius_deg: Annotated[float, Field(gt=0, le=10)] = 0.3


class Fit(_Section):
    """The batch fit and the gates behind which its result may leave."""

    maximum_cycles: Annotated[int, Field(ge=1, le=50)] = 8
    minimum_stars_per_exposure: Annotated[int, Field(ge=3)] = 4
    # A star is dropped when it departs by more than this many robust sigma.
    rejection_sigma: Positive = 5.0
    # Gates.
    minimum_frames: Annotated[int, Field(ge=1)] = 30
    minimum_stars: Annotated[int, Field(ge=1)] = 300
    minimum_coverage: Fraction = 0.5
    maximum_condition: Positive = 1e4
    maximum_change_sigma: Positive = 30.0
    maximum_rms_urad: Positive | None = None
    # RMS of the residuals over the noise model, beyond which the noise or the camera model is
    # not believed.
    maximum_noise_scale: Positive = 5.0


class Sequential(_Section):
    """The sequential estimators: what they assume, and when they are not to be trusted."""

    # Uncertainty of the initial calibration, in sigma of each parameter (Table III has up to 10).
    initial_sd_sigma: Positive = 10.0
    # Random walk of each parameter, in its sigma per square root of an hour; by name where given.
    process_noise_sigma: NotNegative = 0.05
    process_noise: dict[str, NotNegative] = {}
    # Latest frames that are linearised anew while the estimate still moves far.
    relinearised_frames: Annotated[int, Field(ge=1, le=10_000)] = 100
    # Parameters linear in temperature: where they are nominal, the prior sd of a slope in sigma per
    # kelvin, and twice the log evidence that decides for them (Kass & Raftery 1995: very strong).
    reference_temperature_c: Finite = 20.0
    temperature_sd_sigma: Positive = 0.3
    temperature_evidence: Positive = 10.0
    # The watch: over so many frames, the estimate falls back to the baseline when it fixes so many
    # frames fewer, matches a share of stars fewer, or its NIS per arc is so many times the usual.
    window_frames: Annotated[int, Field(ge=5, le=10_000)] = 25
    lost_frames: Annotated[int, Field(ge=1)] = 3
    lost_star_share: Fraction = 0.1
    divergence: Positive = 4.0
    # Gates.  Along directions weaker than this a filter takes its own wandering for information.
    maximum_condition: Positive = 2e3
    maximum_fallbacks: Annotated[int, Field(ge=0)] = 1


class Validation(_Section):
    """What a comparison on held-out telemetry needs."""

    # Fewer frames say nothing that a bootstrap could measure.
    minimum_frames: Annotated[int, Field(ge=2)] = 20


class Ingest(_Section):
    """What ingest accepts."""

    quaternion_norm_tolerance: Positive = 1e-3
    # A frame whose time lies further than this before or behind those of its neighbours in the
    # source is refused, when the neighbours agree.  Below it a wrong time does no harm: in a
    # minute the Earth's velocity turns by 0.001 urad of aberration.
    maximum_backwards_s: Positive = 60.0
    # Exit code 5 when a larger share of rows is quarantined.
    maximum_quarantine_share: Fraction = 0.05


def _rising(pair: list[float]) -> list[float]:
    if not pair[0] < pair[1]:
        raise ValueError("the smallest value is not below the largest")
    return pair


Range = Annotated[list[Finite], Field(min_length=2, max_length=2), AfterValidator(_rising)]


class Uplink(_Section):
    """What may be sent to the spacecraft, beyond the gates of fit and validation."""

    # Smallest and largest value of a parameter that the sensor may ever be given.
    limits: dict[str, Range] = {}
    # Largest change against what is on board: of a parameter in sigma (fit.maximum_change_sigma if
    # not given), and the turn of C_SD.
    maximum_change_sigma: Positive | None = None
    maximum_turn_deg: Positive = 10.0


class SensorConfig(_Section):
    """One sensor type, as its TOML file describes it."""

    schema_: Literal["stcal.sensor/1"] = Field(alias="schema")
    name: Annotated[str, Field(min_length=1, max_length=100), AfterValidator(_printable)]
    sensor_ids: Annotated[list[Annotated[str, Field(min_length=1)]], Field(min_length=1)]
    detector: Detector
    camera: CameraSection
    noise: Noise
    catalogue: CatalogueSection
    matching: Matching
    fit: Fit = Fit()
    sequential: Sequential = Sequential()
    validation: Validation = Validation()
    ingest: Ingest = Ingest()
    uplink: Uplink = Uplink()

    @model_validator(mode="after")
    def _noise_names(self) -> SensorConfig:
        names = CAMERAS[self.camera.model].parameter_names
        unknown = [name for name in self.sequential.process_noise if name not in names]
        if unknown:
            raise ValueError(f"sequential.process_noise: not a parameter: {', '.join(unknown)}")
        unknown = [name for name in self.uplink.limits if name not in names]
        if unknown:
            raise ValueError(f"uplink.limits: not a parameter: {', '.join(unknown)}")
        return self

    def applies_to(self, sensor_id: str) -> bool:
        """Whether the configuration describes this sensor."""
        return any(fnmatchcase(sensor_id, pattern) for pattern in self.sensor_ids)


def load_config(path: Path) -> SensorConfig:
    """Read and validate a sensor configuration.

    Raises
    ------
    ConfigError
        Naming the file and every error in it.
    """
    document = read_toml(path)
    try:
        config = SensorConfig.model_validate(document)
    except ValidationError as error:
        lines = error_lines(error)
        camera = document.get("camera")
        # Pydantic checks a section as a whole only when each of its fields is right.
        if isinstance(camera, dict) and not any(e["loc"] == ("camera",) for e in error.errors()):
            problems = _name_problems(camera.get("model"), camera.get("scale"))
            lines += [f"  camera: {problem}" for problem in problems]
        raise ConfigError(f"{path}:\n" + "\n".join(lines)) from None
    if config.catalogue.path is not None:
        resolved = str(path_beside(path, config.catalogue.path, "catalogue.path"))
        catalogue = config.catalogue.model_copy(update={"path": resolved})
        config = config.model_copy(update={"catalogue": catalogue})
    return config


def path_beside(file: Path, name: str, key: str) -> Path:
    """Return the absolute path that ``key`` of a configuration names relative to its ``file``.

    Raises
    ------
    ConfigError
        When no path can be made of the name.
    """
    try:
        return (file.parent / name).resolve()
    except (ValueError, RuntimeError) as error:  # a NUL character; a loop of symbolic links
        raise ConfigError(f"{file}:\n  {key}: {name!r}: {error}") from None


def error_lines(error: ValidationError) -> list[str]:
    """Return a line for each error, with the place in the file."""
    lines = []
    for item in error.errors():
        where = ".".join(str(part) for part in item["loc"]) or "file"
        lines.append(f"  {where}: {item['msg'].removeprefix('Value error, ')}")
    return lines


def config_json(config: SensorConfig) -> str:
    """Return the validated configuration as canonical JSON: what a store records."""
    return config.model_dump_json(by_alias=True, indent=1) + "\n"


def config_from_json(text: str, path: str) -> SensorConfig:
    """Read what :func:`config_json` wrote."""
    try:
        return SensorConfig.model_validate_json(text)
    except ValidationError as error:
        raise ConfigError(f"{path}:\n" + "\n".join(error_lines(error))) from None


def config_sha256(config: SensorConfig) -> str:
    """Return the hex SHA-256 of the canonical JSON."""
    return hashlib.sha256(config_json(config).encode()).hexdigest()
