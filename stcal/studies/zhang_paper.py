"""What Zhang et al. 2024 publish, in the units of the document.

Their Tables 1 to 5 are not part of the text that is at hand: orbit, detector and initial values are
this study's own choice (``zhang_scene``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stcal.constants import DEG
from stcal.geometry.rotations import nearest_rotation, vector_from_matrix
from stcal.pipeline.numbers import numbers

Floats = NDArray[np.float64]

NAMES = ("x0_px", "y0_px", "f_m", "k1_per_px2", "k2_per_px4")
NOISE_SD_PX, RUNS = 0.2, 100
# Time to convergence of either stage, and the length of the first.
CALIBRATION_S, ALIGNMENT_S, LENGTH_S = 300.0, 200.0, 500.0
# Centroid of Table 4.
SPOT_PX = (432.56, 547.51)

# Errors after 300 s, each of the curve that is averaged over the runs.
_ERROR = dict(zip(NAMES, (0.01, 0.03, 1e-6, 0.03e-8, 0.004e-14), strict=True))
# Averages of the curves over 500 s.
_AVERAGE = dict(zip(NAMES, (499.81, 529.68, 74.002e-3, 1.95e-8, -9.64e-15), strict=True))
# Figure 9: mean square error [px^2] after so many seconds.
_MEAN_SQUARE = {"t_s": [100.0, 500.0], "px2": [0.1, 0.0013]}
# Figure 10, at the corners.
_LARGEST_PX = 0.13

# Eqs (52) and (53), the true and the estimated matrix as printed.
_TRUE_MATRIX = np.array(
    [
        [0.999695, 0.017449, -0.017452],
        [-0.017145, 0.999700, 0.017449],
        [0.017751, -0.017145, 0.999695],
    ]
)
_FOUND_MATRIX = np.array(
    [
        [0.99969, 0.01735, -0.01742],
        [-0.01698, 0.99970, 0.01751],
        [0.01772, -0.01721, 0.99969],
    ]
)
_ALIGNMENT = {"element": 4.4e-5, "diagonal": 3.3e-6, "angle_deg": 0.0076}


def true_mounting() -> Floats:
    """Return c_sb (3, 3): matrix (52), which as printed is a rotation to 7e-7 only."""
    return nearest_rotation(_TRUE_MATRIX)


def published() -> dict[str, Any]:
    """Return what the paper publishes, named as the study names its own numbers."""
    return {
        "noise_sd_px": NOISE_SD_PX,
        "runs": RUNS,
        "calibration_s": CALIBRATION_S,
        "alignment_s": ALIGNMENT_S,
        "error": _ERROR,
        "average": _AVERAGE,
        "mean_square": _MEAN_SQUARE,
        "largest_distortion_px": _LARGEST_PX,
        "alignment": _ALIGNMENT,
        "matrix": numbers(_FOUND_MATRIX),
        "printed": _printed_errors(),
    }


def _printed_errors() -> dict[str, Any]:
    """Return what the printed matrices (52) and (53) themselves differ by."""
    difference = np.abs(_FOUND_MATRIX - _TRUE_MATRIX)
    turn = vector_from_matrix((nearest_rotation(_FOUND_MATRIX) @ true_mounting().T)[None])[0]
    return {
        "element": float(difference.mean()),
        "diagonal": float(np.diag(difference).mean()),
        "angles_deg": numbers(turn / DEG),
    }
