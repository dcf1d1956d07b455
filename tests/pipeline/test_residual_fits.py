"""Every residual in a batch fit and in filters, through the same functions."""

import json

import numpy as np
import pytest
from conftest import ROOT, simulation, st16_matcher

from stcal.calibration import load
from stcal.cli import main
from stcal.pipeline.filtering import Variant
from stcal.pipeline.fit import fit_batch
from stcal.pipeline.sequential import fit_sequential
from stcal.pipeline.validate import compare
from stcal.residuals import RESIDUALS, Residual

PROVENANCE = {"parent_sha256": "a" * 64}


def fit(data, residual, method):
    frames = [data.calibration.frames]
    if method == "batch":
        return fit_batch(frames, data.initial, st16_matcher(), PROVENANCE, residual=residual)
    variant = Variant(method=method, residual=residual)
    return fit_sequential(frames, data.initial, st16_matcher(), PROVENANCE, variant)


@pytest.mark.parametrize("method", ["batch", "ekf", "sqrf", "ukf", "smoother"])
@pytest.mark.parametrize("name", [name for name in RESIDUALS if name != "arclength"])
def test_every_residual_reaches_the_noise_with_every_estimator(name, method):
    data = simulation(4, 54, 250)
    result = fit(data, Residual(name), method)
    assert result.calibration is not None, result.document["verdict"]
    assert result.document["residual"].startswith(name)
    truth = compare([data.validation.frames], data.true, result.calibration, st16_matcher())
    assert truth.sums[1].rms_rad <= 1.01 * truth.sums[0].rms_rad
    error = result.calibration.camera.parameters - data.true.camera.parameters
    nees = error @ np.linalg.solve(result.calibration.covariance, error)
    noted = any("cosines" in note for note in result.document["verdict"]["notes"])
    assert noted == (name == "cosine")
    if name != "cosine":
        assert 0.8 < nees < 26.1


def test_the_command_hands_the_residual_on(tmp_path, capsys):
    """The file of a fit by singular values is the core's."""
    sample = ROOT / "sample_telemetry"
    store, config = str(tmp_path / "store"), str(ROOT / "configs" / "st16.toml")
    source = str(sample / "ST16-4.calibration.csv.gz")
    assert main(["ingest", source, "--store", store, "--config", config, "--json"]) == 0
    initial, out = str(sample / "ST16-4.initial.json"), tmp_path / "fit"
    arguments = ["fit", "--batch", "--store", store, "--sensor", "ST16-4", "--initial", initial]
    options = ["--residual", "singular-values", "--groups", "1", "--values", "1,3"]
    assert main([*arguments, *options, "--out", str(out), "--json"]) == 0
    capsys.readouterr()
    document = json.loads((out / "fit.json").read_text())
    assert document["residual"] == "singular-values, groups 1, values 1,3"
    found = load(out / "calibration.json")
    assert found.quality["residual"] == document["residual"]
    assert main([*arguments, "--out", str(tmp_path / "arcs"), "--json"]) == 0
    arcs = load(tmp_path / "arcs" / "calibration.json")
    sd = np.sqrt(np.diag(found.covariance))
    departure = np.abs(found.camera.parameters - arcs.camera.parameters) / sd
    assert 1e-6 < departure.max() < 3.0
