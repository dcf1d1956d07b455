"""Measured stars of two ground cameras: fitted on even frames, judged on odd ones."""

import numpy as np
import pytest
from conftest import REAL, ROOT

from stcal.calibration import load
from stcal.catalog.catalogue import load_bundled, select
from stcal.config import load_config
from stcal.matching import Matcher, match
from stcal.pipeline.fit import fit_batch
from stcal.pipeline.validate import compare
from stcal.telemetry.ingest import ingest
from stcal.telemetry.store import Store

pytestmark = pytest.mark.skipif(not REAL.is_dir(), reason="the measured stars are not at hand")

# Arclength RMS on held-out frames that the fit must reach, urad.
LIMITS = {"esa_tetra3": 36.5, "spel_sost": 275.0}


@pytest.fixture(scope="module", params=LIMITS)
def camera(request, tmp_path_factory):
    name = request.param
    config = load_config(ROOT / "configs" / f"{name}.toml")
    store = Store.open(tmp_path_factory.mktemp(name) / "store", create=True)
    summary = ingest([REAL / f"{name}.csv.gz"], store, [config])
    assert summary.exit_code == 0
    frames = store.read_frames(name)
    section = config.catalogue
    catalogue = select(load_bundled(), section.limiting_magnitude, section.merge_separation_arcsec)
    return name, frames, Matcher(catalogue, config), load(REAL / f"{name}.initial.json")


@pytest.mark.parametrize("matches", ["telemetry", "lost-in-space"])
def test_the_fit_reaches_the_noise_of_real_stars(camera, matches):
    name, frames, matcher, initial = camera
    even = frames.frame_id % 2 == 0
    result = fit_batch([frames.take(even)], initial, matcher, {"parent_sha256": ""}, matches)
    assert result.accepted, result.document["verdict"]
    held_out = compare([frames.take(~even)], initial, result.calibration, matcher)
    assert held_out.sums[1].rms_rad * 1e6 <= LIMITS[name]
    assert held_out.fixed[1].all()
    assert held_out.stars[1].sum() > 2 * held_out.stars[0].sum()


def test_lost_in_space_agrees_with_the_independent_matches(camera):
    """The telemetered star_id come from another program."""
    _, frames, matcher, initial = camera
    result = fit_batch([frames], initial, matcher, {"parent_sha256": ""}, "lost-in-space")
    found = match(frames, result.calibration.camera, np.eye(3), matcher)
    codes = matcher.catalogue.star_id
    both = found.is_matched & (frames.star_id != 0) & np.isin(frames.star_id, codes)
    assert both.sum() > 500
    assert (codes[found.star[both]] == frames.star_id[both]).mean() > 0.99
