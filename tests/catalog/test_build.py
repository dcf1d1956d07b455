"""Official files written from real stars must give those stars back."""

from __future__ import annotations

from pathlib import Path

import erfa
import numpy as np
import pytest
from catalog_official_files import hipparcos_line, supplement_line, tycho2_line, write

from stcal.catalog.build import build_catalogue
from stcal.catalog.catalogue import StarCatalogue, load_bundled
from stcal.catalog.identifiers import TYCHO_BASE, decode, encode
from stcal.constants import ARCSEC, DEG, MAS
from stcal.errors import InputError


def tycho_numbers(code: int) -> tuple[int, int, int]:
    rest, c = divmod(code - TYCHO_BASE, 10)
    return (*divmod(rest, 100_000), c)  # type: ignore[return-value]


def spherical(stars: StarCatalogue) -> dict[str, np.ndarray]:
    """Right ascension, declination [rad], proper motions [mas/yr] and parallax [mas] of J2000."""
    x, y, z = stars.direction.T
    ra, dec = np.arctan2(y, x) % (2 * np.pi), np.arcsin(z)
    east = np.stack([-np.sin(ra), np.cos(ra), 0 * ra], axis=1)
    north = np.cross(stars.direction, east)
    return {
        "ra": ra,
        "dec": dec,
        "pm_ra": np.sum(stars.motion * east, axis=1) / MAS,
        "pm_dec": np.sum(stars.motion * north, axis=1) / MAS,
        "parallax": stars.parallax / MAS,
    }


def at_1991(sky: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The same at J1991.25, by ERFA's pmsafe: a path apart from the package's own."""
    found = erfa.pmsafe(
        sky["ra"],
        sky["dec"],
        sky["pm_ra"] * MAS / np.cos(sky["dec"]),
        sky["pm_dec"] * MAS,
        np.maximum(sky["parallax"], 1.0) * 1e-3,
        0.0,
        *(2451545.0, 0.0, 2451545.0, -8.75 * 365.25),
    )
    ra, dec, pm_ra, pm_dec = found[:4]
    return {
        "ra": ra % (2 * np.pi),
        "dec": dec,
        "pm_ra": pm_ra * np.cos(dec) / MAS,
        "pm_dec": pm_dec / MAS,
        "parallax": sky["parallax"],
    }


def tycho_magnitudes(v: float, bv: float) -> tuple[float, float]:
    """BT and VT that give V and B-V."""
    colour = bv / 0.850
    vt = v + 0.090 * colour
    return vt + colour, vt


def real_stars(seed: int, n: int) -> StarCatalogue:
    """Single Hipparcos stars of the bundled catalogue with a colour, fast ones among them."""
    c = load_bundled()
    usable = (c.star_id < TYCHO_BASE) & (c.source == "H") & np.isfinite(c.colour)
    usable &= ~c.multiple & (c.magnitude < 7.9) & (c.colour < 1.8)
    rows = np.flatnonzero(usable)
    speed = np.linalg.norm(c.motion[rows], axis=1)
    fast = rows[np.argsort(speed)[-20:]]
    slow = np.random.default_rng(seed).choice(np.setdiff1d(rows, fast), n - 20, replace=False)
    return c.take(np.concatenate([fast, slow]))


def tyc(i: int) -> tuple[int, int, int]:
    return 1 + i % 9537, 1 + i % 12121, 1 + i % 3


@pytest.fixture
def truth() -> StarCatalogue:
    return real_stars(11, 300)


def main_rows(stars: StarCatalogue, with_hip: bool = True) -> list[str]:
    sky = spherical(stars)
    rows = []
    for i in range(stars.n_stars):
        bt, vt = tycho_magnitudes(stars.magnitude[i], stars.colour[i])
        rows.append(
            tycho2_line(
                tyc(i),
                sky["ra"][i] / DEG,
                sky["dec"][i] / DEG,
                pm=(sky["pm_ra"][i], sky["pm_dec"][i]),
                bt=bt,
                vt=vt,
                hip=int(stars.star_id[i]) if with_hip else None,
            )
        )
    return rows


def hip_rows(stars: StarCatalogue) -> list[str]:
    sky = at_1991(spherical(stars))
    return [
        hipparcos_line(
            int(stars.star_id[i]),
            sky["ra"][i],
            sky["dec"][i],
            pm=(sky["pm_ra"][i], sky["pm_dec"][i]),
            parallax=sky["parallax"][i],
            hp=stars.magnitude[i] + hp_minus_v(stars.colour[i]),
            colour=stars.colour[i],
        )
        for i in range(stars.n_stars)
    ]


def hp_minus_v(bv: float) -> float:
    """Hp - V of a star of this B-V, from Bessell 2000 (PASP 112, 961, table 2)."""
    colour = [-0.219, -0.095, -0.005, 0.227, 0.465, 0.674, 0.878, 1.034]
    return float(np.interp(bv, colour, [-0.066, -0.021, 0.011, 0.069, 0.108, 0.134, 0.155, 0.162]))


def by_id(found: StarCatalogue, truth: StarCatalogue) -> StarCatalogue:
    """The rows of ``found`` in the order of ``truth``."""
    row = {int(code): i for i, code in enumerate(found.star_id)}
    return found.take(np.array([row[int(code)] for code in truth.star_id]))


def offset(a: StarCatalogue, b: StarCatalogue) -> np.ndarray:
    return np.linalg.norm(a.direction - b.direction, axis=1)


def test_tycho2_alone(truth: StarCatalogue, tmp_path: Path) -> None:
    path = write(tmp_path / "tyc2.dat", main_rows(truth))
    found = build_catalogue([path], None, None, 8.0)
    assert found.n_stars == truth.n_stars
    assert (np.diff(found.magnitude) >= 0).all()
    found = by_id(found, truth)
    assert set(found.source) == {"T"}
    assert offset(found, truth).max() < 0.05 * MAS
    assert np.abs(found.motion - truth.motion).max() < 0.1 * MAS
    assert np.abs(found.magnitude - truth.magnitude).max() < 0.001
    assert np.abs(found.colour - truth.colour).max() < 0.001
    assert not found.parallax.any()
    assert not found.multiple.any()


def test_supplement_is_moved_from_1991(truth: StarCatalogue, tmp_path: Path) -> None:
    sky = at_1991(spherical(truth))
    rows = []
    for i in range(truth.n_stars):
        bt, vt = tycho_magnitudes(truth.magnitude[i], truth.colour[i])
        place = sky["ra"][i] / DEG, sky["dec"][i] / DEG
        motion = (sky["pm_ra"][i], sky["pm_dec"][i])
        number = int(truth.star_id[i])
        rows.append(supplement_line(tyc(i), *place, pm=motion, bt=bt, vt=vt, hip=number))
    faint = [tycho2_line((9000, 1, 1), 1.0, 1.0, bt=12.0, vt=11.0)]
    main = write(tmp_path / "tyc2.dat", faint)
    found = build_catalogue([main], write(tmp_path / "suppl_1.dat", rows), None, 8.0)
    found = by_id(found, truth)
    assert set(found.source) == {"S"}
    # Proper motions are given to 0.1 mas per year, over 8.75 years.
    assert offset(found, truth).max() < 0.8 * MAS
    assert np.abs(found.motion - truth.motion).max() < 0.1 * MAS


def test_hipparcos_astrometry_is_taken_and_moved(truth: StarCatalogue, tmp_path: Path) -> None:
    # Tycho-2 positions 0.3 arcsec off: the better ones must win, from the other epoch.
    rng = np.random.default_rng(3)
    shift = 0.3 * ARCSEC * np.cross(truth.direction, rng.normal(size=(truth.n_stars, 3)))
    moved = truth.direction + shift / np.linalg.norm(shift, axis=1, keepdims=True) * 0.3 * ARCSEC
    from dataclasses import replace

    off = replace(truth, direction=moved / np.linalg.norm(moved, axis=1, keepdims=True))
    main = write(tmp_path / "tyc2.dat", main_rows(off))
    hip = write(tmp_path / "hip2.dat", hip_rows(truth))
    found = by_id(build_catalogue([main], None, hip, 8.0), truth)
    assert set(found.source) == {"H"}
    assert offset(found, truth).max() < 0.1 * MAS
    assert np.abs(found.motion - truth.motion).max() < 0.05 * MAS
    assert np.abs(found.parallax - truth.parallax).max() < 0.006 * MAS
    np.testing.assert_allclose(found.magnitude, truth.magnitude, atol=0.001)


def test_hipparcos_farther_than_an_arcsecond_is_not_taken(
    truth: StarCatalogue, tmp_path: Path
) -> None:
    from dataclasses import replace

    east = np.cross([0.0, 0.0, 1.0], truth.direction)
    east /= np.linalg.norm(east, axis=1, keepdims=True)
    off = replace(truth, direction=truth.direction + 1.2 * ARCSEC * east)
    main = write(tmp_path / "tyc2.dat", main_rows(truth))
    hip = write(tmp_path / "hip2.dat", hip_rows(off))
    found = by_id(build_catalogue([main], None, hip, 8.0), truth)
    assert set(found.source) == {"T"}
    assert offset(found, truth).max() < 0.05 * MAS
    assert np.abs(found.parallax - truth.parallax).max() < 0.006 * MAS


def test_hipparcos_adds_what_tycho2_lacks_and_nothing_twice(
    truth: StarCatalogue, tmp_path: Path
) -> None:
    rows = main_rows(truth)
    nameless = main_rows(truth, with_hip=False)
    # Tycho-2 has the first 100 with their number, the next 100 without it, and lacks the rest.
    main = write(tmp_path / "tyc2.dat", rows[:100] + nameless[100:200])
    hip = write(tmp_path / "hip2.dat", hip_rows(truth))
    found = build_catalogue([main], None, hip, 8.0)
    assert found.n_stars == truth.n_stars
    found = by_id(found, truth)
    assert found.source[:200].tolist() == ["H"] * 200
    assert found.source[200:].tolist() == ["h"] * 100
    assert offset(found, truth).max() < 0.1 * MAS
    in_table = truth.colour < 1.03
    assert np.abs(found.magnitude - truth.magnitude)[in_table].max() < 0.015
    assert found.provenance["counts"]["by_source"] == {"H": 200, "h": 100}


def test_a_faint_tycho_star_keeps_its_hipparcos_entry_out(tmp_path: Path) -> None:
    main = [
        tycho2_line((1, 1, 1), 10.0, 10.0, bt=7.0, vt=6.5),
        tycho2_line((1, 2, 1), 20.0, 10.0, bt=8.2, vt=8.15, hip=77),
    ]
    # Hp alone would put HIP 77 at V 7.95, within the limit.
    hip = hipparcos_line(77, 20.0 * DEG, 10.0 * DEG, pm=(0, 0), parallax=5.0, hp=7.95, colour=0.04)
    paths = [write(tmp_path / "tyc2.dat", main)], write(tmp_path / "hip2.dat", [hip])
    found = build_catalogue(paths[0], None, paths[1], 8.0)
    assert decode(found.star_id).tolist() == ["TYC 1-1-1"]


def test_components_of_one_hipparcos_number(tmp_path: Path) -> None:
    """Acrux: its two stars stay two, the brighter bears the number; neither gets Hipparcos'."""
    a, b = (186.649750, -63.099056), (186.652069, -63.099503)
    main = [
        tycho2_line((8979, 3465, 1), *b, bt=1.40, vt=1.547, hip=60718, ccdm="B"),
        tycho2_line((8979, 3464, 1), *a, bt=1.08, vt=1.245, hip=60718, ccdm="A"),
    ]
    hip = hipparcos_line(
        *(60718, a[0] * DEG, a[1] * DEG), pm=(-35.0, -15.0), parallax=10.13, hp=0.67, colour=-0.24
    )
    paths = [write(tmp_path / "tyc2.dat", main)], write(tmp_path / "hip2.dat", [hip])
    found = build_catalogue(paths[0], None, paths[1], 8.0)
    assert decode(found.star_id).tolist() == ["HIP 60718", "TYC 8979-3465-1"]
    assert found.source.tolist() == ["T", "T"]
    assert found.multiple.all()
    assert not found.merged.any()
    np.testing.assert_allclose(found.parallax / MAS, 10.13)
    total = -2.5 * np.log10(np.sum(10.0 ** (-0.4 * found.magnitude)))
    assert total == pytest.approx(0.63, abs=0.02)


def test_components_that_list_one_combined_magnitude_count_once(tmp_path: Path) -> None:
    rows = [
        supplement_line((5, 1, 1), 50.0, 0.0, pm=(10.0, 0.0), bt=6.5, vt=6.0, hip=99, ccdm="A"),
        supplement_line(
            *((5, 1, 2), 50.0, 2.0 / 3600), pm=(10.0, 0.0), bt=6.5, vt=6.0, hip=99, ccdm="B"
        ),
        supplement_line((5, 2, 1), 50.1, 0.0, pm=None, bt=6.5, vt=6.0),
        supplement_line((5, 3, 1), 50.2, 0.0, pm=None, bt=6.5, vt=6.0),
    ]
    main = write(tmp_path / "tyc2.dat", [tycho2_line((1, 1, 1), 1.0, 1.0, bt=12.0, vt=11.0)])
    found = build_catalogue([main], write(tmp_path / "suppl_1.dat", rows), None, 8.0)
    assert decode(found.star_id).tolist() == ["HIP 99", "TYC 5-2-1", "TYC 5-3-1"]
    assert found.merged.tolist() == [True, False, False]
    # In the middle, moved by 8.75 years.
    assert found.direction[0, 2] / ARCSEC == pytest.approx(1.0, abs=1e-3)
    ra = np.arctan2(found.direction[0, 1], found.direction[0, 0])
    assert (ra - 50.0 * DEG) / MAS == pytest.approx(87.5, abs=0.1)


def test_missing_values(tmp_path: Path) -> None:
    main = [
        tycho2_line((1, 1, 1), None, None, pm=None, bt=6.5, vt=6.0, pflag="X", observed=(5, 5)),
        tycho2_line((1, 2, 1), 10.0, 5.0, bt=None, vt=6.0),
        tycho2_line((1, 3, 1), 11.0, 5.0, bt=None, vt=None),
        tycho2_line((1, 2, 1), 10.0, 5.0, bt=None, vt=6.0),
    ]
    found = build_catalogue([write(tmp_path / "tyc2.dat", main)], None, None, 8.0)
    assert decode(found.star_id).tolist() == ["TYC 1-2-1", "TYC 1-1-1"]
    assert found.source.tolist() == ["T", "X"]
    assert not found.motion.any()
    assert np.isnan(found.colour[0])
    counts = found.provenance["counts"]
    assert (counts["without_proper_motion"], counts["without_colour"]) == (1, 1)


def test_parts_of_the_main_file_and_provenance(truth: StarCatalogue, tmp_path: Path) -> None:
    rows = main_rows(truth)
    parts = [
        write(tmp_path / "tyc2.dat.00", rows[:150]),
        write(tmp_path / "tyc2.dat.01", rows[150:]),
    ]
    found = build_catalogue(parts, None, None, 7.0)
    assert found.n_stars == (by_id(found, found).magnitude <= 7.0).sum()
    assert found.n_stars == pytest.approx((truth.magnitude <= 7.0).sum(), abs=1)
    assert set(found.provenance["inputs"]) == {"tyc2.dat.00", "tyc2.dat.01"}
    assert all(len(digest) == 64 for digest in found.provenance["inputs"].values())
    assert found.provenance["epoch"] == "J2000.0"


def test_no_star_bright_enough(tmp_path: Path) -> None:
    rows = [tycho2_line((1, 1, 1), 1.0, 1.0, bt=7.5, vt=7.0)]
    with pytest.raises(InputError, match=r"tyc2\.dat: no star down to magnitude 2"):
        build_catalogue([write(tmp_path / "tyc2.dat", rows)], None, None, 2.0)


def test_every_identifier_is_used_once(truth: StarCatalogue, tmp_path: Path) -> None:
    main = write(tmp_path / "tyc2.dat", main_rows(truth))
    hip = write(tmp_path / "hip2.dat", hip_rows(real_stars(12, 500)))
    found = build_catalogue([main], None, hip, 8.0)
    assert len(np.unique(found.star_id)) == found.n_stars
    assert (encode(decode(found.star_id)) == found.star_id).all()
