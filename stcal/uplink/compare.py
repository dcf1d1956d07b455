"""Compare two calibrations of one camera model: parameters, alignment, directions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.calibration import Calibration
from stcal.cameras import Camera
from stcal.constants import ARCSEC, URAD
from stcal.errors import InputError
from stcal.residuals.arclength import separations
from stcal.units import unit_of
from stcal.uplink.encode import standard_deviations

Floats = NDArray[np.float64]

SCHEMA = "stcal.uplink-diff/1"
_GRID = (37, 49)


@dataclass(frozen=True)
class DirectionChange:
    """Change of the star vectors over the detector.

    Attributes
    ----------
    worst_urad, rms_urad : largest and RMS angle left after the best rotation is removed
    at_row_px, at_col_px : where the largest is
    rotation_d_arcsec : (3,) the rotation removed, old to new directions, axes of D
    net_s_arcsec : (3,) rotation of the directions in S, camera and C_SD together: the jump that
        the attitude would make
    """

    worst_urad: float
    rms_urad: float
    at_row_px: float
    at_col_px: float
    rotation_d_arcsec: Floats
    net_s_arcsec: Floats


def compare(old: Calibration, new: Calibration) -> dict[str, Any]:
    """Return the JSON document of the difference NEW minus OLD.

    Raises
    ------
    InputError
        When the two have another camera model or detector: their parameters do not compare; or
        when a camera model breaks down on the detector.
    """
    _require_same_camera(old, new)
    change = direction_change(old, new)
    return {
        "schema": SCHEMA,
        "old": {"sensor_id": old.sensor_id, "serial": old.serial},
        "new": {"sensor_id": new.sensor_id, "serial": new.serial},
        "parameters": parameter_changes(old, new),
        "c_sd_rotation_arcsec": c_sd_rotation(old, new).tolist(),
        "directions": {
            "worst_urad": change.worst_urad,
            "rms_urad": change.rms_urad,
            "at_row_px": change.at_row_px,
            "at_col_px": change.at_col_px,
            "rotation_removed_arcsec": change.rotation_d_arcsec.tolist(),
            "net_rotation_arcsec": change.net_s_arcsec.tolist(),
        },
    }


def parameter_changes(old: Calibration, new: Calibration) -> list[dict[str, Any]]:
    """Return per parameter: old, new, change, sd of NEW, change in that sd and in both combined.

    A quotient is None where its sd is missing or zero.
    """
    result = []
    spreads = zip(standard_deviations(old), standard_deviations(new), strict=True)
    for name, (old_sd, new_sd) in zip(new.camera.parameter_names, spreads, strict=True):
        before, after = old.camera.value(name), new.camera.value(name)
        both = None if old_sd is None or new_sd is None else float(np.hypot(old_sd, new_sd))
        result.append(
            {
                "name": name,
                "unit": unit_of(name).si,
                "old": before,
                "new": after,
                "change": after - before,
                "sd": _finite(new_sd),
                "change_sd": _quotient(after - before, new_sd),
                "change_combined_sd": _quotient(after - before, both),
            }
        )
    return result


def c_sd_rotation(old: Calibration, new: Calibration) -> Floats:
    """Return (3,) arcsec: rotation vector, axes of S, that takes the old C_SD to the new."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_matrix(new.c_sd @ old.c_sd.T)
    return np.asarray(turn.as_rotvec() / ARCSEC)


def direction_change(old: Calibration, new: Calibration) -> DirectionChange:
    """Return how star vectors on a grid over the detector change from OLD to NEW.

    The bulk rotation is the least-squares one (Wahba's problem, solved by Kabsch's method); the
    arclengths, and so the residuals of a fit, only see what is left.

    Raises
    ------
    InputError
        When a camera model breaks down on the detector.
    """
    m, n = detector_grid(old.camera)
    with np.errstate(all="ignore"):  # checked below
        before, after = old.camera.directions(m, n), new.camera.directions(m, n)
    for name, found in zip(_names(old, new), (before, after), strict=True):
        if not np.isfinite(found).all():
            raise InputError(f"{name}: gives no directions somewhere on its detector")
    rotation, left = _best_rotation(before, after)
    worst = int(np.argmax(left))
    net, _ = _best_rotation(before @ old.c_sd.T, after @ new.c_sd.T)
    return DirectionChange(
        worst_urad=float(left[worst] / URAD),
        rms_urad=float(np.sqrt(np.mean(left**2)) / URAD),
        at_row_px=float(m[worst]),
        at_col_px=float(n[worst]),
        rotation_d_arcsec=rotation / ARCSEC,
        net_s_arcsec=net / ARCSEC,
    )


def _best_rotation(before: Floats, after: Floats) -> tuple[Floats, Floats]:
    """Return the rotation vector (3,) [rad] from before to after, and the angles left (S,)."""
    from scipy.spatial.transform import Rotation

    rotation, _ = Rotation.align_vectors(after, before)
    return np.asarray(rotation.as_rotvec()), separations(after, rotation.apply(before))


def detector_grid(camera: Camera) -> tuple[Floats, Floats]:
    """Return centroids (S,) over the detector, its edges included."""
    m, n = np.meshgrid(
        np.linspace(-0.5, camera.rows - 0.5, _GRID[0]),
        np.linspace(-0.5, camera.cols - 0.5, _GRID[1]),
        indexing="ij",
    )
    return m.ravel(), n.ravel()


def _names(old: Calibration, new: Calibration) -> tuple[str, str]:
    return old.origin or "OLD", new.origin or "NEW"


def _require_same_camera(old: Calibration, new: Calibration) -> None:
    kinds = [
        (c.camera.model.name, c.camera.rows, c.camera.cols, c.camera.pixel_size_m)
        for c in (old, new)
    ]
    if kinds[0] != kinds[1]:
        described = [f"{name} {rows} x {cols}, {size:g} m" for name, rows, cols, size in kinds]
        first, second = _names(old, new)
        raise InputError(
            f"not comparable: {first} is a camera {described[0]}; {second} is {described[1]}"
        )


def _quotient(change: float, sd: float | None) -> float | None:
    return _finite(change / sd) if sd else None


def _finite(value: float | None) -> float | None:
    return value if value is not None and np.isfinite(value) else None
