"""Screening must not cost a drifting camera what it doesn't cost a constant one."""

from dataclasses import replace

import numpy as np
from conftest import ROOT, st16_matcher

from stcal.matching import match
from stcal.pipeline.filter_run import run_filter
from stcal.pipeline.filtering import Variant, make_filter
from stcal.simulate import load_scenario, scenario_with, simulate


def filtered(simulated, frames):
    """Errors over sd of the final camera, starting from the true one, with a walk in f."""
    matcher = st16_matcher()
    chosen = make_filter(Variant(process_noise={"f_m": 1.0}), simulated.true, matcher)
    # The scale of the noise is known, so that both runs screen alike.
    tally = chosen.start.tally.copy()
    tally[:2] = 1e12
    start = replace(chosen.start, tally=tally)
    baseline = match(frames, simulated.true.camera, simulated.true.c_sd, matcher)
    run = run_filter(replace(chosen, start=start), [baseline], start)
    parameters = chosen.parameters(run.history.x)[-1]
    return parameters, run.history.sd[-1, chosen.constants] * chosen.model.scale[chosen.constants]


def test_drift_does_not_bias_the_other_parameters():
    """The same noise on a constant and on a drifting focal length: the rest ends the same.

    Judged by the latest state, far stars of older frames were cut on one side: up to 1.5 sd.
    """
    scenario = load_scenario(ROOT / "configs" / "scenarios" / "st16-drift.toml")
    scenario = scenario_with(
        scenario, detection__false_stars_per_exposure=0.0, detection__outlier_probability=0.0,
        noise__sd_px=0.6,
    )  # fmt: skip
    still = scenario.camera.model_copy(update={"drift": type(scenario.camera.drift)()})
    truth = simulate(scenario, 1).calibration.truth.parameters
    constant = simulate(scenario_with(scenario, camera=still), 100)
    frames, true = constant.calibration.frames, constant.true.camera
    # The same directions, noise included, as the drifting camera sees them.
    seen = true.directions(frames.row_px, frames.col_px)
    m, n = true.with_parameters(truth[frames.exposure_of_star // 2].T).project(seen)
    there, sd = filtered(constant, replace(frames, row_px=m, col_px=n))
    here, _ = filtered(constant, frames)
    names = true.parameter_names
    change = (there - here) / sd
    others = [k for k, name in enumerate(names) if name != "f_m"]
    assert np.abs(change[others]).max() < 0.35
    followed = (there - truth[-1]) / sd
    assert abs(followed[names.index("f_m")]) < 4.0
