"""Whether the data support parameters that depend on the temperature."""

from __future__ import annotations

import numpy as np

from stcal.pipeline.filter_run import FrameHistory, Run


def choose_model(runs: dict[str, Run], evidence: float) -> str:
    """Return the model that the data support: twice the log evidence decides for temperature."""
    if "thermal" not in runs:
        return "constant"
    return "thermal" if twice_log_evidence(runs) > evidence else "constant"


def twice_log_evidence(runs: dict[str, Run]) -> float:
    """Return twice the logarithm of the Bayes factor of the thermal against the constant model.

    Each model's evidence is the likelihood of its innovations, under the noise that the better one
    of them sees.
    """
    scale2 = min(run.history.noise_scale[-1] ** 2 for run in runs.values())

    def deviance(history: FrameHistory) -> float:
        return float(np.nansum(history.nis / scale2 + history.log_determinant))

    return deviance(runs["constant"].history) - deviance(runs["thermal"].history)
