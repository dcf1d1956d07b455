"""Stage ``camera convert``: a calibration in another camera model, judged and described."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.calibration import Calibration
from stcal.cameras import CameraModel
from stcal.cameras.convert import Conversion, convert, detector_grid
from stcal.constants import ARCSEC, URAD
from stcal.errors import InputError
from stcal.geometry.rotations import vector_from_matrix
from stcal.pipeline.numbers import number, numbers
from stcal.version import __version__

Floats = NDArray[np.float64]

SCHEMA = "stcal.conversion/1"
# Decimals of the error map: far below what matters, and its document stays small.
_URAD_DECIMALS, _PX_DECIMALS = 4, 6
# Centroids that a camera gives back this well are the same.
_SAME_PX = 1e-6
# Beyond this the new model is no stand-in for the old camera.
_NOTED_PX = 1.0


@dataclass(frozen=True)
class Converted:
    """A finished conversion: the new calibration, and the document that explains it.

    ``calibration`` is None when it was refused; the reasons are in ``document["verdict"]``.
    """

    calibration: Calibration | None
    document: dict[str, Any]


def convert_calibration(
    old: Calibration, model: CameraModel, sha256: str, maximum_urad: float | None = None
) -> Converted:
    """Return a calibration in another camera model that gives the same directions in S.

    Parameters
    ----------
    old : the calibration to convert
    sha256 : of its file, for the provenance
    maximum_urad : the largest error of a direction on the detector; no limit when None

    Raises
    ------
    InputError
        When the old camera's map is not one-to-one over its detector.
    """
    _require_one_to_one(old)
    conversion = convert(old.camera, model)
    errors = _errors(conversion)
    reasons = _refusals(conversion, errors, maximum_urad)
    new = _calibration(old, conversion, sha256, errors)
    document = {
        "schema": SCHEMA,
        "sensor_id": old.sensor_id,
        "software": f"stcal {__version__}",
        "verdict": {"accepted": not reasons, "reasons": reasons, "notes": _notes(old, new, errors)},
        "old": _description(old) | {"file": old.origin or None, "sha256": sha256},
        "new": _description(new),
        "turn_arcsec": numbers(vector_from_matrix(conversion.turn[None])[0] / ARCSEC),
        "errors": errors | {"maximum_urad": maximum_urad},
        "field": _field(conversion),
    }
    return Converted(None if reasons else new, document)


def _require_one_to_one(calibration: Calibration) -> None:
    """Refuse a camera whose distortion folds its field: no other could stand for it."""
    camera = calibration.camera
    centroids = detector_grid(camera)
    with np.errstate(all="ignore"):  # checked here
        back = camera.project(camera.directions(*centroids))
    if not np.allclose(back, centroids, rtol=0.0, atol=_SAME_PX):
        where = calibration.origin or f"the calibration of {calibration.sensor_id}"
        raise InputError(f"{where}: the camera's map is not one-to-one over the detector")


def _errors(conversion: Conversion) -> dict[str, Any]:
    """Return the error of the directions in numbers; in pixels None where there is no image."""
    urad = conversion.angle / URAD
    px = np.linalg.norm(conversion.error_px, axis=1)
    worst = int(np.argmax(urad))
    return {
        "worst_urad": number(urad[worst]),
        "worst_px": number(px.max()),
        "at_row_px": float(conversion.row_px[worst]),
        "at_col_px": float(conversion.col_px[worst]),
        "rms_urad": number(np.sqrt(np.mean(urad**2))),
        "rms_px": number(np.sqrt(np.mean(px**2))),
    }


def _refusals(
    conversion: Conversion, errors: dict[str, Any], maximum_urad: float | None
) -> list[str]:
    """Return the reasons why the new camera must not stand for the old one."""
    name, reasons = conversion.camera.model.name, []
    if not conversion.converged:
        reasons.append(f"the least squares for {name} did not converge")
    if errors["worst_px"] is None:
        reasons.append(f"{name} has no image of some directions that the old camera sees")
    if maximum_urad is not None and not conversion.angle.max() <= maximum_urad * URAD:
        reasons.append(
            f"{name} departs by {conversion.angle.max() / URAD:.3g} urad at row "
            f"{errors['at_row_px']:.1f}, column {errors['at_col_px']:.1f}, at most "
            f"{maximum_urad:g} allowed"
        )
    return reasons


def _notes(old: Calibration, new: Calibration, errors: dict[str, Any]) -> list[str]:
    """Return what a reader of the new file should know."""
    notes = []
    worst = errors["worst_px"]
    if worst is not None and worst > _NOTED_PX:
        notes.append(
            f"{new.camera.model.name} cannot follow this camera: centroids move by up to "
            f"{worst:.1f} px"
        )
    if new.covariance is not None and new.camera.model is not old.camera.model:
        notes.append(
            "the covariance is the old one carried over, without the error of the conversion"
        )
    return notes


def _calibration(
    old: Calibration, conversion: Conversion, sha256: str, errors: dict[str, Any]
) -> Calibration:
    """Return the new calibration; C_SD takes up the turn, so that directions in S agree.

    The serial rises: no two files of a sensor share one.  What the old file says of its fit stays.
    """
    covariance = old.covariance
    if covariance is not None:
        covariance = conversion.sensitivity @ covariance @ conversion.sensitivity.T
    made = {
        "converted_from_sha256": sha256,
        "converted_from_model": old.camera.model.name,
        "converted_by": f"stcal {__version__}",
    }
    return replace(
        old,
        serial=old.serial + 1,
        camera=conversion.camera,
        c_sd=old.c_sd @ conversion.turn,
        covariance=covariance,
        provenance=old.provenance | made,
        quality=old.quality | {"conversion": errors},
        origin="",
    )


def _description(calibration: Calibration) -> dict[str, Any]:
    """Return what a document says of one of the two calibrations."""
    camera, covariance = calibration.camera, calibration.covariance
    unknown = [None] * len(camera.parameters)
    sds = unknown if covariance is None else numbers(np.sqrt(np.diag(covariance).clip(0.0)))
    listed = zip(camera.parameter_names, numbers(camera.parameters), sds, strict=True)
    return {
        "serial": calibration.serial,
        "model": camera.model.name,
        "parameters": [{"name": name, "value": value, "sd": sd} for name, value, sd in listed],
        "c_sd": numbers(calibration.c_sd),
    }


def _field(conversion: Conversion) -> dict[str, Any]:
    """Return the error over the detector, one number a node of the grid."""
    camera = conversion.camera
    d_row, d_col = conversion.error_px.T
    return {
        "rows": camera.rows,
        "cols": camera.cols,
        "row_px": numbers(conversion.row_px),
        "col_px": numbers(conversion.col_px),
        "error_row_px": numbers(np.round(d_row, _PX_DECIMALS)),
        "error_col_px": numbers(np.round(d_col, _PX_DECIMALS)),
        "error_urad": numbers(np.round(conversion.angle / URAD, _URAD_DECIMALS)),
    }
