from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from stcal.catalog.catalogue import BUNDLED, StarCatalogue, load_bundled
from stcal.catalog.identifiers import decode, encode
from stcal.catalog.sphere import motion_vector, unit_vector
from stcal.constants import ARCSEC, DEG, MAS

ROOT = Path(__file__).parents[2]
TABLE = ROOT.parent / "shared" / "data" / "catalog" / "tycho2_bright.parquet"
needs_table = pytest.mark.skipif(
    not TABLE.exists(), reason="the table that the bundled catalogue is made of is not here"
)

# ICRS J2000.0 of well-known stars as SIMBAD lists them: h m s, d m s, mas/yr, V.
KNOWN = {
    "HIP 32349": ((6, 45, 8.91728), (-16, 42, 58.0171), (-546.01, -1223.07), -1.46),
    "HIP 91262": ((18, 36, 56.33635), (38, 47, 1.2802), (200.94, 286.23), 0.03),
    "HIP 11767": ((2, 31, 49.09456), (89, 15, 50.7923), (44.48, -11.85), 2.02),
    "HIP 27989": ((5, 55, 10.30536), (7, 24, 25.4304), (27.54, 11.30), 0.42),
    "HIP 71683": ((14, 39, 36.49400), (-60, 50, 2.3737), (-3679.25, 473.67), 0.01),
    "HIP 69673": ((14, 15, 39.67207), (19, 10, 56.6730), (-1093.39, -2000.06), -0.05),
}


def row_of(catalogue: StarCatalogue, text: str) -> int:
    found = np.flatnonzero(catalogue.star_id == encode([text])[0])
    assert len(found) == 1, text
    return int(found[0])


@pytest.mark.parametrize("text", KNOWN)
def test_known_stars(text: str) -> None:
    (h, m, s), (d, dm, ds), (east, north), v = KNOWN[text]
    ra = (h + m / 60 + s / 3600) * 15 * DEG
    dec = np.copysign(abs(d) + dm / 60 + ds / 3600, d) * DEG
    catalogue = load_bundled()
    row = row_of(catalogue, text)
    place = unit_vector(np.array([ra]), np.array([dec]))[0]
    assert np.linalg.norm(catalogue.direction[row] - place) / ARCSEC < 0.1
    motion = motion_vector(*np.array([[ra], [dec], [east], [north]]))[0] * MAS
    assert np.linalg.norm(catalogue.motion[row] - motion) / MAS < 2.0
    assert catalogue.magnitude[row] == pytest.approx(v, abs=0.06)


def test_every_star_is_usable() -> None:
    c = load_bundled()
    assert c.n_stars == 46_132
    assert len(np.unique(c.star_id)) == c.n_stars
    assert (encode(decode(c.star_id)) == c.star_id).all()
    assert np.abs(np.linalg.norm(c.direction, axis=1) - 1.0).max() < 1e-12
    assert np.abs(np.sum(c.direction * c.motion, axis=1)).max() < 1e-11
    assert (c.parallax >= 0).all()
    assert c.parallax.max() / MAS == pytest.approx(796.92, abs=0.01)
    assert c.magnitude.max() <= 8.0 + 1e-6
    assert set(c.source) == set(c.provenance["sources"])
    assert c.direction.flags.c_contiguous
    assert c.direction.dtype == np.float64


def test_a_resolved_system_counts_its_light_once() -> None:
    # Acrux: two components, V 1.3 and 1.6, both listed with the system's 0.77.
    c = load_bundled()
    row = row_of(c, "HIP 60718")
    assert c.magnitude[row] == pytest.approx(0.77, abs=1e-6)
    assert bool(c.merged[row])
    assert bool(c.multiple[row])
    near = np.linalg.norm(c.direction - c.direction[row], axis=1) < 60 * ARCSEC
    assert near.sum() == 1
    # VT 1.245 and 1.547: the photocentre lies 43 % of the way from A to B.
    a = unit_vector(np.array([186.649750]) * DEG, np.array([-63.099056]) * DEG)[0]
    b = unit_vector(np.array([186.652069]) * DEG, np.array([-63.099503]) * DEG)[0]
    share = (c.direction[row] - a) @ (b - a) / ((b - a) @ (b - a))
    assert share == pytest.approx(1.0 / (1.0 + 10.0 ** (0.4 * 0.302)), abs=0.01)


def test_the_file_is_small() -> None:
    assert BUNDLED.stat().st_size < 3_000_000


@needs_table
def test_the_table_gives_the_bundled_file_byte_for_byte(tmp_path: Path) -> None:
    spec = importlib.util.spec_from_file_location(
        "bundle_catalogue", ROOT / "tools" / "bundle_catalogue.py"
    )
    assert spec is not None
    assert spec.loader is not None
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    tool.main(TABLE, tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == BUNDLED.read_bytes()


@needs_table
def test_no_star_of_the_table_is_lost() -> None:
    import pandas as pd

    table = pd.read_parquet(TABLE)
    text = np.where(table.hip > 0, "HIP " + table.hip.astype(str), "TYC " + table.tyc_id.fillna(""))
    assert set(encode(text.astype(object)).tolist()) == set(load_bundled().star_id.tolist())
    # All the light is there, once for each system.
    once = table[(table.hip <= 0) | ~table.duplicated("hip")]
    light = np.sum(10.0 ** (-0.4 * once.v))
    assert np.sum(10.0 ** (-0.4 * load_bundled().magnitude)) == pytest.approx(light, rel=1e-6)
