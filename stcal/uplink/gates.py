"""The gates that an upload must pass: each tells why it must not leave, and its figures.

A gate never raises; ``judge`` runs all of them, so that every reason is told at once.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.calibration import Calibration
from stcal.config import SensorConfig
from stcal.constants import DEG
from stcal.geometry.rotations import vector_from_matrix
from stcal.uplink.held_out import at, is_number, tai_ns, worse
from stcal.uplink.tables import Checked
from stcal.uplink.verify import Difference

HASHES = ("telemetry_sha256", "catalogue_sha256", "config_sha256", "parent_sha256")
_SHA256 = re.compile(r"[0-9a-f]{64}")
# Of correlations: what rounding leaves of a matrix that is symmetric and positive.
_ROUNDING = 1e-6


@dataclass(frozen=True)
class Candidate:
    """What the gates look at.

    Attributes
    ----------
    calibration, sha256 : the new calibration and the hash of its file
    parent, parent_sha256 : the one on board
    validation : the document of a validation of these two, or None
    config : the sensor's configuration, or None where no store was named
    on_disk : the hashes of HASHES but the parent's as the files on disk have them, or None
    readback : how a dump of the table on board departs from the parent, None without a dump
    table : what encoding for the target found, None without a target
    """

    calibration: Calibration
    sha256: str
    parent: Calibration
    parent_sha256: str
    validation: Mapping[str, Any] | None = None
    config: SensorConfig | None = None
    on_disk: Mapping[str, str] | None = None
    readback: list[Difference] | None = None
    table: Checked | None = None


@dataclass(frozen=True)
class Finding:
    """What one gate found: reasons to refuse, none when it passes, and its figures."""

    reasons: tuple[str, ...]
    figures: dict[str, Any] = field(default_factory=dict)


Gate = Callable[[Candidate], Finding]


def identity(candidate: Candidate) -> Finding:
    """The same sensor, the same camera model on the same detector."""
    new, old = candidate.calibration, candidate.parent
    pairs: tuple[tuple[str, Any, Any], ...] = (
        ("sensor_id", new.sensor_id, old.sensor_id),
        ("camera.model", new.camera.model.name, old.camera.model.name),
        ("camera.rows", new.camera.rows, old.camera.rows),
        ("camera.cols", new.camera.cols, old.camera.cols),
        ("camera.pixel_size_m", new.camera.pixel_size_m, old.camera.pixel_size_m),
    )
    reasons = [
        f"{name} is {value!r}, the parent's is {parent_value!r}"
        for name, value, parent_value in pairs
        if value != parent_value
    ]
    if not new.sensor_id.isprintable():
        reasons.append(f"sensor_id {new.sensor_id!r} has characters that cannot be printed")
    return Finding(tuple(reasons), {name: value for name, value, _ in pairs})


def serial(candidate: Candidate) -> Finding:
    """The serial rises over the parent's."""
    new, old = candidate.calibration.serial, candidate.parent.serial
    reasons = () if new > old else (f"serial {new} does not rise over the parent's {old}",)
    return Finding(reasons, {"serial": new, "parent": old})


def covariance(candidate: Candidate) -> Finding:
    """A covariance is there, and says how well each changed parameter is known."""
    calibration = candidate.calibration
    if calibration.covariance is None:
        return Finding(("covariance is missing: this is not a fitted calibration",))
    names = calibration.camera.parameter_names
    variances = dict(zip(names, np.diag(calibration.covariance).tolist(), strict=True))
    # A parameter held fixed has no variance, and then no change either.
    reasons = tuple(
        f"covariance: the variance of {name} is {variance!r}"
        for name, variance in variances.items()
        if not (variance > 0.0 or (variance == 0.0 and _change(name, candidate) == 0.0))
    )
    sds = {name: math.sqrt(v) for name, v in variances.items() if v >= 0.0}
    return Finding(reasons + tuple(_not_a_covariance(calibration.covariance)), sds)


def _not_a_covariance(matrix: NDArray[np.float64]) -> Iterator[str]:
    """Say why a matrix (P, P) with variances above zero is no covariance, judged by correlations.

    A parameter held fixed has a row of zeros.
    """
    variances = np.diag(matrix)
    if not (variances >= 0.0).all():
        return
    sds = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    with np.errstate(over="ignore", invalid="ignore"):
        correlations = matrix / sds / sds[:, None]
        skew = np.abs(correlations - correlations.T).max()
    if not skew <= _ROUNDING:
        yield "covariance: the matrix is not symmetric"
        return
    least = float(np.linalg.eigvalsh(correlations).min())
    if least < -_ROUNDING:
        yield f"covariance: the matrix has the eigenvalue {least:.3g} (as correlations)"


def provenance(candidate: Candidate) -> Finding:
    """Every input is named by its hash, and the parent is the one it was fitted from."""
    found = candidate.calibration.provenance
    reasons = [
        f"provenance.{key} is {found.get(key)!r}, not a SHA-256"
        for key in HASHES
        if not _is_sha256(found.get(key))
    ]
    parent = found.get("parent_sha256")
    if _is_sha256(parent) and parent != candidate.parent_sha256:
        expected = candidate.parent_sha256
        reasons.append(f"provenance.parent_sha256 is {parent}, the parent file's is {expected}")
    return Finding(tuple(reasons), {key: found.get(key) for key in HASHES})


def files(candidate: Candidate) -> Finding:
    """The telemetry, configuration and catalogue on disk are those of the fit."""
    if candidate.on_disk is None:
        return Finding(
            ("no --store: telemetry, configuration and catalogue were not compared with the fit's",)
        )
    found = candidate.calibration.provenance
    reasons = tuple(
        f"{key} of the fit is {found.get(key)}, on disk it is {value}"
        for key, value in candidate.on_disk.items()
        if found.get(key) != value
    )
    return Finding(reasons, dict(candidate.on_disk))


def fit_verdict(candidate: Candidate) -> Finding:
    """The fit itself was accepted."""
    verdict = candidate.calibration.quality.get("verdict")
    return Finding(tuple(_verdict("quality.verdict", verdict)))


def fit_quality(candidate: Candidate) -> Finding:
    """Enough frames, stars and detector coverage, and no direction too weak."""
    if candidate.config is None:
        return Finding(("no --store: the configuration's limits are not known",))
    quality, gates = candidate.calibration.quality, candidate.config.fit
    found = {
        "frames": quality.get("frames"),
        "stars": quality.get("stars_used"),
        "coverage": quality.get("coverage"),
        "condition": at(quality, "condition", "scaled"),
    }
    allowed = {
        "frames": gates.minimum_frames,
        "stars": gates.minimum_stars,
        "coverage": gates.minimum_coverage,
        "condition": gates.maximum_condition,
    }
    reasons = []
    for name, limit in allowed.items():
        value = found[name]
        if not is_number(value):
            reasons.append(f"the fit's quality says no {name}")
        elif (value > limit) if name == "condition" else (value < limit):
            bound = "at most" if name == "condition" else "at least"
            reasons.append(f"{name} {value:.6g}, {bound} {limit:.6g} needed")
    return Finding(tuple(reasons), {"found": found, "allowed": allowed})


def limits(candidate: Candidate) -> Finding:
    """Every parameter lies within what the sensor may ever be given."""
    config, camera = candidate.config, candidate.calibration.camera
    if config is None:
        return Finding(("no --store: the configuration's limits are not known",))
    if camera.model.name != config.camera.model:
        return Finding((f"the configuration is of camera model {config.camera.model!r}",))
    allowed = config.uplink.limits
    reasons = tuple(
        f"{name} is {camera.value(name):.9g}, allowed are {low:.9g} to {high:.9g}"
        for name, (low, high) in allowed.items()
        if not low <= camera.value(name) <= high
    )
    return Finding(reasons, {name: list(pair) for name, pair in allowed.items()})


def change(candidate: Candidate) -> Finding:
    """No parameter changes implausibly far from what is on board."""
    config = candidate.config
    if config is None:
        return Finding(("no --store: the configuration's limits are not known",))
    new, old = candidate.calibration, candidate.parent
    if not new.camera.model.name == old.camera.model.name == config.camera.model:
        return Finding(("parameters of different camera models cannot be compared",))
    most = config.uplink.maximum_change_sigma or config.fit.maximum_change_sigma
    moved = {
        name: _change(name, candidate) / config.camera.scale[name].sigma
        for name in new.camera.parameter_names
    }
    turn = vector_from_matrix((new.c_sd @ old.c_sd.T)[None])[0]
    angle = float(np.linalg.norm(turn)) / DEG
    reasons = [
        f"{name} moves by {value:+.1f} sigma, at most {most:g} allowed"
        for name, value in moved.items()
        if not abs(value) <= most
    ]
    if not angle <= config.uplink.maximum_turn_deg:
        reasons.append(
            f"C_SD turns by {angle:.3f} deg, at most {config.uplink.maximum_turn_deg:g} allowed"
        )
    return Finding(tuple(reasons), {"sigma": moved, "maximum_sigma": most, "turn_deg": angle})


def on_board(candidate: Candidate) -> Finding:
    """A dump of the table on board, where one was read back, holds the parent."""
    if candidate.readback is None:
        return Finding((), {"compared": False})
    reasons = tuple(
        f"on board, {d.field} is {d.found}, the parent has {d.built}" for d in candidate.readback
    )
    return Finding(reasons, {"compared": True})


def validation(candidate: Candidate) -> Finding:
    """On held-out data it is not worse, by a validation of these two files."""
    document = candidate.validation
    if document is None:
        return Finding(("no --validation: nothing proves this upload on held-out data",))
    reasons = list(_verdict("validation verdict", document.get("verdict")))
    if document.get("sensor_id") != candidate.calibration.sensor_id:
        reasons.append(f"validation is of sensor {document.get('sensor_id')!r}")
    expected = {"candidate": candidate.sha256, "baseline": candidate.parent_sha256}
    for which, sha256 in expected.items():
        found = at(document, which, "sha256")
        if found != sha256:
            reasons.append(f"validation {which}.sha256 is {found!r}, the file's is {sha256!r}")
    reasons += worse(document)
    keys = ("availability", "matched_stars", "matched_star_ratio", "matched_star_ratio_interval",
            "common_pair_rms_urad", "rms_ratio", "rms_ratio_interval", "pairs",
            "confidence")  # fmt: skip
    return Finding(tuple(reasons), {key: document.get(key) for key in keys})


def held_out(candidate: Candidate) -> Finding:
    """The frames of the validation are not those of the fit."""
    if candidate.validation is None:
        return Finding(("no --validation: its frames cannot be told from those of the fit",))
    fitted, span = candidate.calibration.provenance, at(candidate.validation, "span")
    times = [at(s, key) for s in (fitted, span) for key in ("from", "to")]
    figures = {"fit": times[:2], "validation": times[2:]}
    ns = [t for t in map(tai_ns, times) if t is not None]
    if len(ns) < len(times) or ns[0] > ns[1] or ns[2] > ns[3]:
        return Finding(("the time spans of fit and validation are not both known",), figures)
    first, last, start, stop = ns
    reasons = []
    if not (start > last or stop < first):
        fit, judged_on = (f"{a} to {b}" for a, b in (times[:2], times[2:]))
        reasons.append(f"the validation's frames ({judged_on}) overlap the fit's ({fit})")
    telemetry = at(candidate.validation, "provenance", "telemetry_sha256")
    if telemetry is not None and telemetry == fitted.get("telemetry_sha256"):
        reasons.append("the validation read the telemetry of the fit, by its hash")
    return Finding(tuple(reasons), figures)


def table(candidate: Candidate) -> Finding:
    """Every format of the target holds the calibration, with rounding that costs nothing."""
    if candidate.table is None:
        return Finding((), {"target": None})
    return Finding(tuple(candidate.table.reasons), candidate.table.figures)


GATES: dict[str, Gate] = {
    "identity": identity,
    "serial": serial,
    "covariance": covariance,
    "provenance": provenance,
    "files": files,
    "fit-verdict": fit_verdict,
    "fit-quality": fit_quality,
    "limits": limits,
    "change": change,
    "on-board": on_board,
    "validation": validation,
    "held-out": held_out,
    "table": table,
}
# What these refuse cannot be wanted: another sensor, a serial used before, wrong bytes.
FIXED = ("identity", "serial", "table")


def judge(candidate: Candidate) -> dict[str, Finding]:
    """Return what every gate found, by its name."""
    return {name: gate(candidate) for name, gate in GATES.items()}


def refusals(found: Mapping[str, Finding], overridden: Iterable[str] = ()) -> list[str]:
    """Return the reasons of all gates that are not overridden, each with its gate's name."""
    kept = set(found) - set(overridden)
    return [f"{name}: {reason}" for name in found if name in kept for reason in found[name].reasons]


def not_finite(document: Any, place: str = "") -> Iterator[str]:
    """Name every number of a JSON document that is NaN or infinite."""
    if isinstance(document, float) and not math.isfinite(document):
        yield f"{place or 'file'} is {document!r}"
    elif isinstance(document, dict):
        for key, value in document.items():
            yield from not_finite(value, f"{place}.{key}" if place else str(key))
    elif isinstance(document, list):
        for index, value in enumerate(document):
            yield from not_finite(value, f"{place}[{index}]")


def _change(name: str, candidate: Candidate) -> float:
    """Change of a parameter; infinite where the parent has no such parameter."""
    parent = candidate.parent.camera
    if name not in parent.parameter_names:
        return math.inf
    return candidate.calibration.camera.value(name) - parent.value(name)


def _is_sha256(value: Any) -> bool:
    return isinstance(value, str) and _SHA256.fullmatch(value) is not None


def _verdict(name: str, found: Any) -> Iterator[str]:
    if not isinstance(found, Mapping):
        yield f"{name} is missing"
    elif found.get("accepted") is not True:
        reasons = found.get("reasons")
        listed = "; ".join(map(str, reasons)) if isinstance(reasons, list) else ""
        yield f"{name} is not accepted" + (f": {listed}" if listed else "")
