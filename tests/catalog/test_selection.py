from __future__ import annotations

import numpy as np
import pytest
from catalog_stars import frame, random_directions, stars, stars_near

from stcal.catalog.catalogue import catalogue_sha256, load_bundled, select
from stcal.catalog.identifiers import encode
from stcal.catalog.merging import brightest_neighbour
from stcal.constants import ARCSEC, DEG, MAS


def test_a_trio_becomes_its_photocentre() -> None:
    magnitude = [4.0, 5.0, 5.5]
    east, north = [0.0, 40.0, -20.0], [0.0, 10.0, 50.0]
    to_east, to_north = frame(211.0, -41.0)
    speed = np.array([[100.0, 0.0], [0.0, -50.0], [30.0, 30.0]]) * MAS
    trio = stars_near(
        *(211.0, -41.0, east, north, magnitude),
        motion=speed @ np.stack([to_east, to_north]),
        parallax=np.array([50.0, 20.0, 0.0]) * MAS,
        colour=np.array([0.2, 1.0, np.nan]),
    )
    one = select(trio, 6.0, 90.0)
    flux = 10.0 ** (-0.4 * np.array(magnitude))
    weight = flux / flux.sum()
    assert one.n_stars == 1
    assert one.star_id[0] == 1
    assert bool(one.merged[0])
    assert bool(one.multiple[0])
    assert one.magnitude[0] == pytest.approx(-2.5 * np.log10(flux.sum()), abs=1e-12)
    assert one.parallax[0] / MAS == pytest.approx(weight @ [50.0, 20.0, 0.0])
    assert one.direction[0] @ to_east / ARCSEC == pytest.approx(weight @ east, abs=1e-5)
    assert one.direction[0] @ to_north / ARCSEC == pytest.approx(weight @ north, abs=1e-5)
    assert one.motion[0] @ to_east / MAS == pytest.approx(weight @ speed[:, 0] / MAS, abs=1e-4)
    assert one.motion[0] @ to_north / MAS == pytest.approx(weight @ speed[:, 1] / MAS, abs=1e-4)
    assert one.motion[0] @ one.direction[0] == pytest.approx(0.0, abs=1e-18)
    assert np.linalg.norm(one.direction[0]) == pytest.approx(1.0, abs=1e-15)
    # B-V of the summed light of the two stars whose colour is known.
    blue = flux[:2] * 10.0 ** (-0.4 * np.array([0.2, 1.0]))
    colour = -2.5 * np.log10(blue.sum() / flux[:2].sum())
    assert one.colour[0] == pytest.approx(colour, abs=1e-12)


def test_light_below_the_limit_counts_when_it_is_merged() -> None:
    pair = stars_near(10.0, 5.0, [0.0, 30.0], [0.0, 0.0], [6.3, 6.3])
    assert select(pair, 5.8, 90.0).magnitude[0] == pytest.approx(6.3 - 2.5 * np.log10(2.0))
    assert select(pair, 5.8, 20.0).n_stars == 0


def test_a_merged_star_fainter_than_the_limit_is_left_out_with_all_its_parts() -> None:
    pair = stars_near(10.0, 5.0, [0.0, 30.0], [0.0, 0.0], [6.3, 7.0])
    assert select(pair, 5.7, 90.0).n_stars == 0


def test_a_chain_is_not_drawn_into_one_point() -> None:
    # Five equal steps of 80 arcsec: as one component it would span four times the separation.
    chain = stars_near(80.0, 20.0, [0, 80, 160, 240, 320], [0.0] * 5, [5.0, 6.0, 4.0, 6.5, 5.5])
    chosen = select(chain, 8.0, 90.0)
    # The brightest (3) takes both neighbours; the ends, out of its reach, stay alone.
    assert chosen.star_id.tolist() == [3, 1, 5]
    assert chosen.merged.tolist() == [True, False, False]


def test_taking_in_order_equals_the_plain_loop() -> None:
    rng = np.random.default_rng(7)
    for separation in (0.5, 1.0, 3.0):
        direction = random_directions(rng, 4000)
        order = rng.permutation(4000)
        expected = np.arange(4000)
        free = np.ones(4000, dtype=bool)
        for star in order:
            if not free[star]:
                continue
            angle = np.linalg.norm(direction - direction[star], axis=1)
            mine = free & (angle <= 2.0 * np.sin(0.5 * separation * DEG))
            expected[mine] = star
            free[mine] = False
        assert (expected != np.arange(4000)).sum() > 100
        got = brightest_neighbour(direction, order, separation * DEG)
        np.testing.assert_array_equal(got, expected)


def test_the_rows_order_does_not_matter() -> None:
    catalogue = load_bundled()
    shuffled = catalogue.take(np.random.default_rng(3).permutation(catalogue.n_stars))
    first, second = select(catalogue, 6.5, 300.0), select(shuffled, 6.5, 300.0)
    assert catalogue_sha256(first) == catalogue_sha256(second)
    assert (np.diff(first.magnitude) >= 0).all()
    assert first.merged.sum() > 500


def test_stars_on_one_place_merge_even_without_a_separation() -> None:
    direction = random_directions(np.random.default_rng(1), 3)[[0, 1, 1, 2]]
    chosen = select(stars(direction), 9.0, 0.0)
    assert chosen.star_id.tolist() == [2, 1, 4]
    assert chosen.merged.tolist() == [True, False, False]


def test_the_selection_is_recorded() -> None:
    selection = select(load_bundled(), 5.8, 90.0).provenance["selection"]
    assert selection == {"limiting_magnitude": 5.8, "merge_separation_arcsec": 90.0}


def magnitude_of(text: str, separation_arcsec: float) -> float | None:
    chosen = select(load_bundled(), 8.0, separation_arcsec)
    found = np.flatnonzero(chosen.star_id == encode([text])[0])
    return float(chosen.magnitude[found[0]]) if len(found) else None


def test_alpha_centauri_is_two_stars_15_arcsec_apart() -> None:
    assert magnitude_of("HIP 71683", 10.0) == pytest.approx(-0.01, abs=1e-5)
    assert magnitude_of("HIP 71681", 10.0) == pytest.approx(1.35, abs=1e-5)
    assert magnitude_of("HIP 71683", 90.0) == pytest.approx(-0.283, abs=1e-3)
    assert magnitude_of("HIP 71681", 90.0) is None


def test_mizar_and_alcor_are_708_arcsec_apart() -> None:
    assert magnitude_of("HIP 65378", 90.0) == pytest.approx(2.23, abs=1e-5)
    assert magnitude_of("HIP 65477", 90.0) == pytest.approx(3.99, abs=1e-5)
    assert magnitude_of("HIP 65477", 720.0) is None
    # Both, and the star of magnitude 7.6 between them.
    assert magnitude_of("HIP 65378", 720.0) == pytest.approx(2.028, abs=1e-3)
