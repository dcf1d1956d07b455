"""The numbers of a calibration that an upload table may hold, by name."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stcal.calibration import Calibration

Floats = NDArray[np.float64]


def quantities(calibration: Calibration) -> dict[str, float | int]:
    """Return every number by name, in SI or pixels as the calibration file has it.

    Camera parameters; ``serial``, ``rows``, ``cols``, ``pixel_size_m``; ``c_sd_11`` ...
    ``c_sd_33``; ``q_sd_x`` ... ``q_sd_w`` with A(q_sd) = c_sd; its conjugate ``q_ds_x`` ...
    """
    camera = calibration.camera
    numbers: dict[str, float | int] = {
        "serial": calibration.serial,
        "rows": camera.rows,
        "cols": camera.cols,
        "pixel_size_m": camera.pixel_size_m,
    }
    numbers |= dict(zip(camera.parameter_names, map(float, camera.parameters), strict=True))
    for (i, j), element in np.ndenumerate(calibration.c_sd):
        numbers[f"c_sd_{i + 1}{j + 1}"] = float(element)
    quaternion = alignment_quaternion(calibration.c_sd)
    signs = {"q_sd": (1.0, 1.0, 1.0, 1.0), "q_ds": (-1.0, -1.0, -1.0, 1.0)}
    for name, sign in signs.items():
        for axis, element, s in zip("xyzw", quaternion, sign, strict=True):
            # Plus zero: no negative zeros.
            numbers[f"{name}_{axis}"] = s * float(element) + 0.0
    return numbers


def alignment_quaternion(c_sd: Floats) -> Floats:
    """Return q_sd (4,), scalar last, A(q_sd) = c_sd, scalar part not negative.

    NaN where the matrix is not of finite numbers or no rotation is near it.
    """
    from scipy.spatial.transform import Rotation

    if not np.isfinite(c_sd).all():
        return np.full(4, np.nan)
    try:
        quaternion = Rotation.from_matrix(c_sd.T).as_quat()
    except (ValueError, np.linalg.LinAlgError):
        return np.full(4, np.nan)
    # A turn of 180 degrees has two quaternions without a scalar part.
    first = next((q for q in quaternion[::-1] if q != 0.0), 1.0)
    return np.asarray(quaternion if first > 0.0 else -quaternion)
