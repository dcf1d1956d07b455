"""Monte Carlo: innovations and errors of the filters within their chi-square bounds."""

import numpy as np
import pytest
from conftest import ROOT, st16_matcher
from scipy.stats import chi2

from stcal.matching import match
from stcal.pipeline.filter_run import run_filter
from stcal.pipeline.filtering import Variant, make_filter
from stcal.pipeline.parameters import parameter_scale
from stcal.simulate import load_scenario, scenario_with, simulate

RUNS, FRAMES = 12, 120
CLEAN = {
    "noise__sd_px": 0.4,
    "detection__outlier_probability": 0.0,
    "detection__false_stars_per_exposure": 0.0,
    "calibration__segments__0__frames": FRAMES,
    "validation__segments__0__frames": 1,
}


@pytest.mark.parametrize("method", ["sqrf", "ukf"])
def test_nis_and_nees_lie_within_their_bounds(method):
    """From the nominal camera, with rematching; 99.9 % bounds."""
    scenario = scenario_with(load_scenario(ROOT / "configs" / "scenarios" / "st16-1.toml"), **CLEAN)
    nis, arcs, nees = 0.0, 0, []
    for seed in range(7001, 7001 + RUNS):
        data = simulate(scenario, seed)
        baseline = match(
            data.calibration.frames, data.initial.camera, data.initial.c_sd, st16_matcher()
        )
        chosen = make_filter(Variant(method=method), data.initial, st16_matcher())
        run = run_filter(chosen, [baseline], chosen.start)
        names = data.initial.camera.parameter_names
        truth = data.true.camera.parameters - data.initial.camera.parameters
        error = run.state.x - truth / parameter_scale(st16_matcher().config, names)
        nees.append(error @ np.linalg.solve(chosen.covariance(run.state), error))
        nis, arcs = nis + np.nansum(run.history.nis), arcs + run.history.arcs.sum()
        assert not run.history.event.any()
    low, high = chi2.ppf([0.0005, 0.9995], arcs) / arcs
    assert low < nis / arcs < high
    low, high = chi2.ppf([0.0005, 0.9995], 8 * RUNS) / RUNS
    assert low < np.mean(nees) < high
