"""What Wu et al. 2019 publish: Tables 1 to 4, in the shape of the study's document."""

from __future__ import annotations

from typing import Any

from stcal.cameras.pinhole_radial import PARAMETER_NAMES

# Section 4.1, test 1: where every calibration starts.
INITIAL = dict(zip(PARAMETER_NAMES, (1.0, 15.5e-3, 960.0, 540.0, 0.0, 0.0), strict=True))
# Table 1: the precision that scales the observability matrix, eq (30).
PRECISION = (1e-5, 1e-7, 1.0, 1.0, 1e-2, 1e-1)
IMAGES, EVALUATION_IMAGES = 2500, 100

MODELS = (1, 2, 3, 4)
# All combinations of singular values, in the order of Table 3.
VALUES = ((1, 2, 3), (2, 3), (1, 2), (1, 3), (1,), (2,), (3,))
# The recommended case: model 4 with the last two values; tests 1 and 2 are of group 2.
MODEL, PAIR, GROUP = 4, (2, 3), 2
GROUPS = (1, 2, 3)
# Methods: angular distances, and the recommended case of singular values.
AD, SVD = "ad", "svd"

# By parameter: the error in percent of the nominal value, models 1 to 4.
_TABLE_2 = (
    (-0.0032, 0.0005, -0.0012, 0.0024),
    (0.0044, 0.0044, 0.0050, 0.0044),
    (-2.6354, 0.1126, -0.0599, -0.2159),
    (0.9508, -0.1315, 0.0940, -0.6011),
    (-0.4379, 1.1205, 0.8043, 1.0729),
    (-47.4027, 32.7026, 15.7377, 25.0508),
)
# Criterion A, mean and sd over images ["], models 1 to 4.
_TABLE_2_A = ((0.852, 0.029), (1.106, 0.060), (4.392, 0.022), (0.465, 0.038))
# Criterion A, mean and sd over images ["], and ms per image.
_TABLE_3 = (
    (0.472, 0.029, 8.28),
    (0.465, 0.038, 6.88),
    (0.701, 0.028, 6.92),
    (2.127, 0.066, 6.88),
    (3.383, 0.096, 5.8),
    (0.384, 0.058, 5.88),
    (2.246, 0.065, 5.76),
)
# By group: criteria A and B, mean and sd over images ["], and ms per image.
_TABLE_4 = {
    1: {AD: (0.535, 0.293, 10.824, 0.879, 260.12), SVD: (0.436, 0.039, 10.854, 0.888, 14.36)},
    2: {AD: (0.419, 0.073, 10.608, 1.295, 31.12), SVD: (0.465, 0.038, 10.630, 1.304, 6.88)},
    3: {AD: (0.344, 0.004, 10.611, 2.569, 4.68), SVD: (0.244, 0.003, 10.612, 2.565, 2.76)},
}
# By group: mean number of stars, and the limiting magnitude.
_GROUPS = {1: (31.4, 6.0), 2: (19.1, 5.5), 3: (7.7, 4.6)}


def model_key(model: int) -> str:
    """Return the method's name of a model with the last two singular values."""
    return SVD if model == MODEL else f"model {model}"


def values_key(values: tuple[int, ...]) -> str:
    """Return the method's name of a combination of singular values in model 4."""
    return SVD if values == PAIR else f"values {','.join(map(str, values))}"


def published() -> dict[str, Any]:
    """Return what the paper publishes of each group, named as the study names its own numbers."""
    groups: dict[str, Any] = {}
    for group, (stars, limit) in _GROUPS.items():
        methods = {name: _compared(row) for name, row in _TABLE_4[group].items()}
        groups[str(group)] = {"stars": stars, "limiting_magnitude": limit, "methods": methods}
    tested = groups[str(GROUP)]["methods"]
    for values, (mean, sd, ms) in zip(VALUES, _TABLE_3, strict=True):
        tested.setdefault(values_key(values), {"a": _criterion(mean, sd), "us_per_image": 1e3 * ms})
    for k, model in enumerate(MODELS):
        column = tested.setdefault(model_key(model), {"a": _criterion(*_TABLE_2_A[k])})
        errors = zip(PARAMETER_NAMES, (row[k] for row in _TABLE_2), strict=True)
        column["error_percent"] = dict(errors)
    return {"groups": groups}


def limiting_magnitude(group: int) -> float:
    """Return a group's published limiting magnitude."""
    return _GROUPS[group][1]


def _compared(row: tuple[float, ...]) -> dict[str, Any]:
    a, a_sd, b, b_sd, ms = row
    return {"a": _criterion(a, a_sd), "b": _criterion(b, b_sd), "us_per_image": 1e3 * ms}


def _criterion(mean: float, sd: float) -> dict[str, float]:
    """Return mean and sd over images, arcsec."""
    return {"mean": mean, "sd": sd}
